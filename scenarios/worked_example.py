# %% [markdown]
# # From a record to a tuning
#
# A flow loop cycles. Its record says whether the valve sticks, what loop it is, and what to type into the controller.
# Open this file as a notebook (VS Code, Spyder, and Jupyter with jupytext know its `# %%` cells), or run it as it is.

# %%
from pathlib import Path

import matplotlib.pyplot as plt

import workbench as wb

HERE = Path(__file__).parent if "__file__" in globals() else Path()

# %% [markdown]
# ## The record
# Three hours of SP, PV and OP from a historian, every 5 s. It was simulated after the paper's Fig. 5, so that the truth
# is known: d = 0.63 %, K = 0.56, tau = 21 s, theta = 5 s. `industrial_flow_loop.yaml` tells the same as a report. The
# last line of a cell shows itself as a table.

# %%
record = wb.read_record(HERE / "data" / "industrial_flow_loop.csv")
wb.plot(record)
record

# %% [markdown]
# ## Does the valve stick?
# `detect` gathers the evidence without a fitted model; `estimate` finds plant, valve and stem position. Each gives its
# reasons, and ranges where the record pins a figure down.

# %%
evidence = wb.detect(record)
evidence

# %%
found = wb.estimate(record)
wb.plot(found)
found

# %% [markdown]
# ## What the present tuning does
# The loop that was found, under the controller as it is set. The describing function looks for a crossing of two loci
# and sees none; the exact long run shows the cycle that it is blind to (Kc K below 1 and Ti above tau + theta).

# %%
present = wb.PID(Kc=0.9, Ti=40.0, derivative_on="pv")
loop = wb.Loop(found.plant, found.valve, present, record.sample_time)
cycle = wb.limit_cycle(loop)
wb.plot(cycle)
cycle

# %%
loci = wb.describing_function(loop)
wb.plot(loci)
loci

# %% [markdown]
# ## A tuning that suits the valve
# `tune` minimises a sum over an exact simulation of what the loop will meet: a setpoint step, a load step, and the
# noise that the record shows. w4 weighs OP's moves, so that the error is not bought with the valve's packing. The
# settings are verified at the digits to type in.

# %%
ahead = wb.Experiment(
    duration=3600.0,
    setpoint=wb.Step(size=1.0, at=60.0),
    load=wb.Step(size=1.0, at=1800.0),
    noise=wb.Noise(sd=0.02, seed=1),
)
cost = wb.Objective(w1=0.5, w3=0.5, w4=0.2)
bounds = wb.Bounds(Kc=(0.2, 6.0), Ti=(10.0, 600.0), Td=(0, 0))
tuned = wb.tune(loop, ahead, cost, bounds, restarts=1)
wb.plot(tuned)
tuned

# %% [markdown]
# ## Side by side
# As found, with the integral action detuned as the usual advice has it, and retuned.

# %%
controllers = {
    "as found": present,
    "integral detuned": wb.apply_rule(loop, wb.DetunedIntegral(10.0)),
    "retuned": tuned.controller,
}
runs = {name: wb.simulate(loop.with_controller(pid), ahead) for name, pid in controllers.items()}
figure, axes = plt.subplots(2, len(runs), figsize=(12, 4), sharex=True, sharey="row", layout="constrained")
for column, (name, run) in zip(axes.T, runs.items(), strict=True):
    wb.plot(run, column)
    column[0].set_title(name, loc="left")
{name: (round(run.kpis.mean_square_error, 4), round(run.kpis.valve_travel, 1)) for name, run in runs.items()}

# %%
runs["retuned"]

# %% [markdown]
# ## What is left for the valve's repair
# The same hour with the valve as it is and with an ideal one, each at its best tuning: what no tuning removes.

# %%
repair = wb.value_of_repair(loop, ahead, cost, tuned=tuned, restarts=1)
print(f"Of the error that the best tuning leaves, {repair.share('mean_square_error'):.0%} goes only with the repair.")
repair
