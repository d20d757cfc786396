"""The tuning problems of `tuning_problems.json`: how they are read, how they are written, and where they came from.

A problem is a loop, an experiment, an objective and bounds, all written out, with the best values known: `nominal`, the
least J of eq. (2) that any search has found, and `worst`, the least of the worst J within 0.1 % of the parameters.
Both definitions stand in the file. The first eight problems are the paper's loop; the others were drawn once by
`python benchmarks/tuning_problems.py`, which writes the statements anew and leaves the best values of unchanged
statements alone. `tuning_reference.py` finds the best values, `tuning.py` measures methods against them.
"""

from __future__ import annotations

import itertools
import json
import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import workbench as wb
from workbench.model.record import FloatArray
from workbench.tune.problem import Problem

FILE = Path(__file__).with_name("tuning_problems.json")
SEED = 20
# Digits beyond those of any controller: the neighbourhood of a problem is then its margin alone.
DIGITS, MARGIN = 12, 0.001
# Optima lie on cliffs; a best value must hold some way off. Not to the last digit: some runs of a two-parameter valve,
# and most worst cases, change a little with any change of the tuning.
HOLD, SAME = 1e-11, 1e-3
DEFINITIONS = {
    "nominal": "J of eq. (2) by exact simulation of the tuning as written",
    "worst": "the largest J at 115 points around the tuning: itself, and p (1 + 0.001 c) for each parameter p with c "
    "from the 8 corners and the 6 middles of the faces of [-1, 1]^3 and from 100 points "
    "numpy.random.default_rng(1).uniform(-1, 1, (100, 3)); a parameter of 0 stays 0",
    "best": f"the least value known that grows by at most {SAME:g} of itself at p (1 + {HOLD:g} c) within the bounds, "
    "c from the 27 points of {-1, 0, 1}^3",
    "start": "the tuning in loop.controller",
    "ends": "the largest value at those 27 points where each of the independent searches of tuning_reference.py ended",
}
KINDS = {"plant": ("FOPDT", "Integrating"), "valve": ("Ideal", "Stenman", "Choudhury", "Deadband")}


@dataclass(frozen=True)
class Stated:
    """One problem as values, and what is known of its best tunings (`nominal`, `worst`: J, tuning, how found).

    mark: a number that changes with the problem's statement, so that results of another one do not count.
    """

    name: str
    loop: wb.Loop
    experiment: wb.Experiment
    objective: wb.Objective
    bounds: wb.Bounds
    best: dict[str, dict[str, Any]]
    mark: int

    def problem(self, margin: float = MARGIN) -> Problem:
        """The problem as the searches see it."""
        return Problem(self.loop, self.experiment, self.objective, self.bounds, DIGITS, margin)

    def value(self, criterion: str, tuning: FloatArray) -> float:
        """The value of a tuning, shape (3,), by the definitions of the file: "nominal" or "worst"."""
        return float(self._values(criterion, tuning[None, :])[0])

    def held(self, criterion: str, tuning: FloatArray) -> float:
        """The largest value at the 27 points around a tuning by which the file judges whether it holds."""
        problem = self.problem()
        steps = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
        return float(self._values(criterion, np.clip(tuning * (1.0 + HOLD * steps), problem.low, problem.high)).max())

    def holds(self, criterion: str, tuning: FloatArray) -> bool:
        """Whether a tuning is far enough from a cliff for its value to be a best known one."""
        return self.held(criterion, tuning) <= (1.0 + SAME) * self.value(criterion, tuning)

    def _values(self, criterion: str, tunings: FloatArray) -> FloatArray:
        problem = self.problem()
        if criterion == "nominal":
            return problem.exact(tunings)
        return problem.worst_below(tunings, np.full(tunings.shape[0], np.inf), dense=True)


def built(part: str, given: dict[str, Any]) -> Any:
    """A plant or a valve from its entry."""
    numbers = dict(given)
    kind = numbers.pop("type")
    if kind not in KINDS[part]:
        raise SystemExit(f"{FILE.name}: {part}.type: {kind!r} is none of {', '.join(KINDS[part])}")
    return getattr(wb, kind)(**numbers)


def stated(entry: dict[str, Any]) -> Stated:
    """A problem from its entry in the file."""
    loop, run = entry["loop"], entry["experiment"]
    pid = dict(loop["controller"])
    if pid.get("derivative_filter") == "none":
        pid["derivative_filter"] = math.inf
    if "output_limits" in pid:
        pid["output_limits"] = tuple(pid["output_limits"])
    return Stated(
        name=entry["name"],
        loop=wb.Loop(built("plant", loop["plant"]), built("valve", loop["valve"]), wb.PID(**pid), loop["sample_time"]),
        experiment=wb.Experiment(
            run["duration"],
            setpoint=[wb.Step(**step) for step in run.get("setpoint", [])] or None,
            load=[wb.Step(**step) for step in run.get("load", [])] or None,
            noise=wb.Noise(**run["noise"]) if "noise" in run else None,
            stem_offset=run.get("stem_offset", 0.0),
        ),
        objective=wb.Objective(**entry["objective"]),
        bounds=wb.Bounds(**{name: tuple(pair) for name, pair in entry["bounds"].items()}),
        best=entry.get("best", {}),
        mark=zlib.crc32(json.dumps({key: part for key, part in entry.items() if key != "best"}).encode()),
    )


def read(file: Path = FILE) -> dict[str, Any]:
    """The whole file."""
    whole: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return whole


def write(whole: dict[str, Any], file: Path = FILE) -> None:
    """Write the file at once, a line for each part of a problem; numbers keep all their digits."""
    lines = ["{", f'"definitions": {json.dumps(whole["definitions"], indent=1)},', f'"seed": {whole["seed"]},']
    lines.append('"problems": [')
    for i, entry in enumerate(whole["problems"]):
        parts = [f" {json.dumps(key)}: {json.dumps(part)}" for key, part in entry.items() if key != "best"]
        best = [f"  {json.dumps(key)}: {json.dumps(part)}" for key, part in entry.get("best", {}).items()]
        if best:
            parts.append(' "best": {\n' + ",\n".join(best) + "}")
        lines.append("{\n" + ",\n".join(parts) + "}" + ("," if i + 1 < len(whole["problems"]) else ""))
    lines += ["]", "}"]
    fresh = file.with_suffix(".tmp")
    fresh.write_text("\n".join(lines) + "\n", encoding="utf-8")
    fresh.replace(file)


def selected(names: list[str] | None, file: Path = FILE) -> list[Stated]:
    """The problems of these names, or all."""
    every = [stated(entry) for entry in read(file)["problems"]]
    unknown = sorted(set(names or ()) - {one.name for one in every})
    if unknown:
        raise SystemExit(f"{file.name} has no problem {', '.join(unknown)}; it has {', '.join(p.name for p in every)}")
    return [one for one in every if not names or one.name in names]


# Where the problems came from.

PAPER_BOUNDS = {"Kc": [0.0, 10.0], "Ti": [5.0, 600.0], "Td": [0.0, 60.0]}
# Structure of each drawn problem: plant, valve, whether D acts, controller, least and largest dead time (in time
# constants; of an integrator in samples), N, what else acts on the loop.
DRAWN: list[tuple[str, str, bool, dict[str, Any], float, float, int, str]] = [
    ("FOPDT", "Stenman", False, {}, 0.0, 0.0, 300, "noise"),
    ("FOPDT", "Stenman", True, {}, 0.2, 0.5, 400, ""),
    ("FOPDT", "Stenman", True, {"derivative_on": "pv"}, 1.0, 2.0, 500, ""),
    ("FOPDT", "Stenman", True, {"derivative_filter": "none"}, 0.3, 0.7, 300, "noise"),
    ("FOPDT", "Stenman", False, {}, 5.0, 5.0, 600, ""),
    ("FOPDT", "Choudhury J<S", True, {}, 0.2, 0.6, 400, ""),
    ("FOPDT", "Choudhury J<S", False, {}, 0.5, 1.5, 500, "load"),
    ("FOPDT", "Choudhury J>S", True, {"derivative_on": "pv"}, 0.2, 0.6, 300, ""),
    ("FOPDT", "Choudhury J=S", False, {}, 0.2, 1.0, 400, "w4"),
    ("FOPDT", "Deadband", False, {}, 0.3, 1.0, 500, "load"),
    ("FOPDT", "Deadband", True, {}, 0.2, 0.6, 400, "w4"),
    ("FOPDT", "Ideal", True, {}, 0.2, 1.0, 300, "w4"),
    ("Integrating", "Stenman", False, {}, 0.0, 4.0, 500, ""),
    ("Integrating", "Stenman", True, {"derivative_on": "pv"}, 2.0, 6.0, 600, "load"),
    ("Integrating", "Choudhury J<S", False, {}, 1.0, 5.0, 400, "noise"),
    ("Integrating", "Deadband", True, {}, 1.0, 5.0, 500, "noise"),
    ("FOPDT", "Stenman", True, {"form": "series"}, 0.2, 0.8, 400, ""),
    ("FOPDT", "Choudhury J<S", True, {"form": "series", "derivative_on": "pv"}, 0.2, 0.8, 300, "limits"),
    ("FOPDT", "Stenman", True, {"derivative_filter": 5.0}, 0.3, 1.0, 400, "limits"),
    ("FOPDT", "Stenman", False, {}, 0.3, 1.0, 1000, "load noise w2"),
    ("FOPDT", "Stenman", True, {"form": "parallel"}, 0.2, 0.8, 200, ""),
    (
        "FOPDT",
        "Stenman",
        True,
        {"derivative_on": "pv", "setpoint_weight": 0.0, "anti_windup": "back_calculation"},
        2.0,
        3.5,
        800,
        "limits load",
    ),
]


def paper(name: str, samples: int, objective: dict[str, float], pid: bool = True, **controller: Any) -> dict[str, Any]:
    """A problem on the paper's loop: the step of 4 from Case 1."""
    return {
        "name": name,
        "loop": {
            "plant": {"type": "FOPDT", "gain": 1.0, "time_constant": 5.0, "dead_time": 1.0},
            "valve": {"type": "Stenman", "d": 2.0},
            "controller": {"Kc": 0.5, "Ti": 20.0, **controller},
            "sample_time": 1.0,
        },
        "experiment": {"duration": float(samples), "setpoint": [{"size": 4.0, "at": 0.0}]},
        "objective": {"w1": 0.5, "w3": 0.5, **objective},
        "bounds": PAPER_BOUNDS if pid else PAPER_BOUNDS | {"Td": [0.0, 0.0]},
    }


def drawn(rng: np.random.Generator) -> list[dict[str, Any]]:
    """The problems of `DRAWN` with random numbers, each of three digits."""

    def short(number: float) -> float:
        return float(f"{number:.3g}")

    def between(low: float, high: float) -> float:
        return short(math.exp(rng.uniform(math.log(low), math.log(high))))

    entries = []
    for i, (plant, valve, derivative, controller, least, most, samples, extras) in enumerate(DRAWN):
        Ts = float(rng.choice([0.5, 1.0, 2.0, 5.0]))
        step = between(1.0, 10.0) * (-1.0 if i % 5 == 3 else 1.0)
        if plant == "FOPDT":
            gain, tau = between(0.3, 3.0), short(Ts * between(4.0, 20.0))
            theta = short(tau * rng.uniform(least, most))
            process = {"type": plant, "gain": gain, "time_constant": tau, "dead_time": theta}
            own = tau / (gain * (theta + Ts))
            start = (short(min(0.5 / gain, own)), short(4.0 * tau))
            band = short(abs(step) / gain * rng.uniform(0.1, 0.6))
        else:
            gain, theta = short(between(0.01, 0.1) / Ts), short(Ts * rng.uniform(least, most))
            process = {"type": plant, "gain": gain, "dead_time": theta}
            tau, own = 4.0 * (theta + Ts), 1.0 / (gain * (theta + Ts))
            start = (short(0.25 * own), short(4.0 * tau))
            # An integrator needs no lasting OP: the band is counted in the OP that a brisk controller gives.
            band = short(abs(step) * own * rng.uniform(0.05, 0.3))
        kinds = {
            "Ideal": {"type": "Ideal"},
            "Stenman": {"type": "Stenman", "d": band},
            "Choudhury J<S": {"type": "Choudhury", "S": band, "J": short(band * rng.uniform(0.1, 0.7))},
            "Choudhury J>S": {"type": "Choudhury", "S": band, "J": short(band * rng.uniform(1.1, 1.6))},
            "Choudhury J=S": {"type": "Choudhury", "S": band, "J": band},
            "Deadband": {"type": "Deadband", "b": band},
        }
        parallel = controller.get("form") == "parallel"
        top = short(4.0 * own)
        Ti, Td = (short(0.5 * tau), short(60.0 * (tau + theta))), short(2.0 * (tau + theta))
        if parallel:
            # There 1/Ti and Td are gains: the ranges of the ideal form at half the largest Kc.
            Ti, Td = (short(Ti[0] / top), short(Ti[1] / (0.05 * top))), short(Td * top / 2.0)
            start = (start[0], short(start[1] / start[0]))
        settings = {"Kc": start[0], "Ti": start[1], **controller}
        end = samples * Ts
        experiment: dict[str, Any] = {"duration": end, "setpoint": [{"size": step, "at": 0.0}]}
        objective = {"w1": 0.5, "w3": 0.5}
        scale = step / gain if plant == "FOPDT" else band
        if "limits" in extras:
            settings["output_limits"] = sorted([short(-0.3 * scale), short(1.6 * scale)])
        if "load" in extras:
            experiment["load"] = [{"size": short(scale * rng.uniform(-0.5, 0.5)), "at": round(samples / 2) * Ts}]
        if "noise" in extras:
            experiment["noise"] = {"sd": short(abs(step) * rng.uniform(0.005, 0.02)), "seed": i}
        if "w4" in extras:
            objective["w4"] = short(gain**2 * rng.uniform(0.05, 0.5))
        if "w2" in extras:
            # Of the order of 1 % of the error's own cost per sample.
            objective["w2"] = short((gain if plant == "FOPDT" else gain * Ts) ** 2 * rng.uniform(0.01, 0.05))
        words = [plant, valve, "PID" if derivative else "PI", *(f"{k} {v}" for k, v in controller.items()), extras]
        entries.append(
            {
                "name": f"R{i + 1:02d}",
                "about": ", ".join(word for word in words if word),
                "loop": {"plant": process, "valve": kinds[valve], "controller": settings, "sample_time": Ts},
                "experiment": experiment,
                "objective": objective,
                "bounds": {"Kc": [0.0, top], "Ti": list(Ti), "Td": [0.0, Td if derivative else 0.0]},
            }
        )
    return entries


def statements() -> dict[str, Any]:
    """The whole file without best values."""
    on_pv = {"derivative_on": "pv"}
    entries = [
        paper("A200", 200, {}, **on_pv),
        paper("C200", 200, {"w4": 0.05}),
        paper("D200", 200, {"w2": 0.05}, **on_pv),
        paper("E200", 200, {"w4": 0.5}, **on_pv),
        paper("D400", 400, {"w2": 0.05}, **on_pv),
        paper("E400", 400, {"w4": 0.5}, **on_pv),
        paper("P1000-PI", 1000, {}, pid=False, derivative_filter="none"),
        paper("P1000-PID", 1000, {}, derivative_filter="none"),
    ]
    entries += drawn(np.random.default_rng(SEED))
    return {"definitions": DEFINITIONS, "seed": SEED, "problems": entries}


def main() -> None:
    """Write the statements; best values of unchanged ones stay."""
    known = {}
    if FILE.exists():
        known = {json.dumps(e | {"best": None}, sort_keys=True): e.get("best") for e in read()["problems"]}
    whole = statements()
    for entry in whole["problems"]:
        best = known.get(json.dumps(entry | {"best": None}, sort_keys=True))
        if best:
            entry["best"] = best
    write(whole)
    print(f"{FILE.name}: {len(whole['problems'])} problems")


if __name__ == "__main__":
    main()
