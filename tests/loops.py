"""Random loops and experiments for property tests, and an independent simulator written from the published law."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import strategies as st

import workbench as wb

PAPER_PLANT = wb.FOPDT(gain=1.0, time_constant=5.0, dead_time=1.0)


def paper_loop(Kc: float, Ti: float, Td: float = 0.0, **controller: Any) -> wb.Loop:
    """The paper's loop (section III.C): unfiltered derivative on error, Stenman valve of d = 2 %, Ts = 1 s."""
    settings = {"derivative_filter": math.inf, **controller}
    return wb.Loop(PAPER_PLANT, wb.Stenman(d=2.0), wb.PID(Kc=Kc, Ti=Ti, Td=Td, **settings), sample_time=1.0)


def paper_step(duration: float = 1000.0) -> wb.Experiment:
    return wb.Experiment(duration=duration, setpoint=wb.Step(size=4.0, at=0.0))


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


valves = st.one_of(
    st.just(wb.Ideal()),
    st.builds(wb.Stenman, d=numbers(0.1, 4.0)),
    st.builds(lambda fs, share: wb.He(fs, share * fs), fs=numbers(0.1, 4.0), share=numbers(0.0, 1.0)),
    st.builds(wb.Choudhury, S=numbers(0.1, 6.0), J=numbers(0.0, 6.0)),
    # Its edges are told from where OP stopped the stem, in the kernel from the stem itself: off the steps that OP moves
    # by and off 0, so that rounding decides no slip.
    st.builds(lambda S, share: wb.Kano(S + 3e-4, share * S + 1e-4), S=numbers(0.1, 6.0), share=numbers(0.0, 1.0)),
    st.builds(wb.Deadband, b=numbers(0.1, 5.0)),
    st.builds(
        lambda S, share, S_down, share_down: wb.Directional(
            wb.Choudhury(S, share * S), wb.Choudhury(S_down, share_down * S_down)
        ),
        S=numbers(0.1, 6.0),
        share=numbers(0.0, 1.0),
        S_down=numbers(0.1, 6.0),
        share_down=numbers(0.0, 1.0),
    ),
)
plants = st.one_of(
    st.builds(wb.FOPDT, gain=numbers(0.2, 3.0), time_constant=numbers(1.0, 40.0), dead_time=numbers(0.0, 12.0)),
    st.builds(wb.Integrating, gain=numbers(0.01, 0.1), dead_time=numbers(0.0, 6.0)),
)


@st.composite
def controllers(draw: st.DrawFn) -> wb.PID:
    limited = draw(st.booleans())
    return wb.PID(
        Kc=draw(numbers(0.05, 2.0)),
        Ti=draw(st.one_of(numbers(2.0, 200.0), st.just(math.inf))),
        Td=draw(st.one_of(st.just(0.0), numbers(0.1, 4.0))),
        derivative_on=draw(st.sampled_from(["error", "pv"])),
        derivative_filter=draw(st.sampled_from([math.inf, 10.0, 4.0])),
        setpoint_weight=draw(st.sampled_from([1.0, 0.5, 0.0])),
        action=draw(st.sampled_from(["reverse", "direct"])) if limited else "reverse",
        output_limits=(-draw(numbers(0.5, 5.0)), draw(numbers(0.5, 5.0))) if limited else None,
        anti_windup=draw(st.sampled_from(["clamp", "back_calculation"])),
        tracking_time=draw(st.one_of(st.none(), numbers(1.0, 50.0))),
        output_resolution=draw(st.sampled_from([0.0, 0.0, 0.25, 0.7])),
    )


loops = st.builds(
    wb.Loop, plant=plants, valve=valves, controller=controllers(), sample_time=st.sampled_from([0.5, 1.0])
)


@st.composite
def experiments(draw: st.DrawFn, duration: float = 150.0) -> wb.Experiment:
    return wb.Experiment(
        duration=duration,
        setpoint=wb.Step(draw(numbers(-6.0, 6.0)), at=draw(st.sampled_from([0.0, 7.0, 20.5]))),
        load=draw(st.one_of(st.none(), st.builds(wb.Step, size=numbers(-2.0, 2.0), at=numbers(0.0, duration)))),
        noise=draw(st.one_of(st.none(), st.builds(wb.Noise, sd=numbers(0.0, 0.3), seed=st.integers(0, 9)))),
    )


seconds = st.integers(1, 20).map(float)
compensators = st.one_of(
    st.builds(wb.IntegralDeadband, band=numbers(0.05, 2.0), ratio=st.sampled_from([1.0, 8.0, math.inf])),
    st.builds(
        lambda a, width, more: wb.Knocker(a, width, width + more),
        a=numbers(0.1, 4.0),
        width=seconds,
        more=st.integers(0, 9),
    ),
    st.builds(wb.ConstantReinforcement, amplitude=numbers(0.1, 4.0)),
    st.builds(
        wb.TwoMove,
        amplitude=numbers(0.1, 6.0),
        at=st.one_of(st.just(0.0), seconds),
        steady_output=numbers(-3.0, 3.0),
        release=st.one_of(st.just(math.inf), numbers(0.1, 4.0)),
    ),
    st.builds(
        wb.Dither, amplitude=numbers(0.1, 4.0), period=st.sampled_from([2.0, 4.0, 10.0]), shape=st.just("square")
    ),
)


class IndependentCompensator:
    """A compensator by its published equation, from the whole history of the controller's own output."""

    def __init__(self, given: Any, Ts: float, offset: float, limits: tuple[float, float] | None) -> None:
        self.given, self.Ts, self.offset = given, Ts, offset
        self.limits = limits or (-math.inf, math.inf)
        self.own: list[float] = []
        self.held: float | None = None

    def share(self, e: float) -> float:
        g = self.given
        return 1.0 / g.ratio if isinstance(g, wb.IntegralDeadband) and abs(e) <= g.band else 1.0

    def output(self, u: float, e: float, rest: float, integral: float) -> tuple[float, float]:
        g, k = self.given, len(self.own)
        self.own.append(u)
        added = 0.0
        if isinstance(g, wb.Knocker):
            h, tau = round(g.period / self.Ts), round(g.width / self.Ts)
            pulse, phase = divmod(k, h)
            if pulse >= 1 and phase < tau:
                added = g.amplitude * float(np.sign(u - self.own[(pulse - 1) * h]))
        elif isinstance(g, wb.ConstantReinforcement):
            added = g.amplitude * float(np.sign(u - (self.own[k - 1] if k else self.offset)))
        elif isinstance(g, wb.Dither):
            n = round(g.period / self.Ts)
            added = g.amplitude if k % n < n // 2 else -g.amplitude
        elif isinstance(g, wb.TwoMove):
            if self.held is not None:
                u, integral = self.held, self.held - rest
                if abs(e) > g.release:
                    self.held = None
            elif k == round(g.at / self.Ts):
                self.held = min(max(g.steady_output, self.limits[0]), self.limits[1])
                added = abs(u - g.steady_output) + g.amplitude
        return min(max(u + added, self.limits[0]), self.limits[1]), integral


def independent_simulation(loop: wb.Loop, r: Any, load: Any, noise: Any, offset: float = 0.0) -> dict[str, list[float]]:
    """The law written once more, sample by sample, with no code of the package.

    r, load (in % of opening), noise: N + 1 values.
    """
    pid, plant, Ts = loop.controller, loop.plant, loop.sample_time
    n = len(r) - 1
    Kc = pid.Kc if pid.action == "reverse" else -pid.Kc
    own = Ts * loop.scan
    Tf = pid.Td / pid.derivative_filter
    sign = -1 if loop.fail_open else 1
    m = math.floor(plant.dead_time / Ts + 1e-9)
    f = plant.dead_time / Ts - m
    f = 0.0 if f < 1e-9 else f
    integral = derivative = s_last = x = y = 0.0
    u_last = offset
    moving, direction = False, 0
    stopped_at, came, stands = 0.0, 1, True  # Kano's u_s, d and stp
    compensator = IndependentCompensator(pid.compensator, Ts * loop.scan, offset, pid.output_limits)
    v: list[float] = []
    out: dict[str, list[float]] = {"pv": [], "op": [], "valve": []}

    def past(j: int) -> float:
        return v[j] if j >= 0 else 0.0

    for k in range(n):
        measured = y + noise[k]
        e = r[k] - measured
        P = Kc * (pid.setpoint_weight * r[k] - measured)
        before = integral
        kept = integral, derivative, s_last
        rises = Kc * own / pid.Ti * e * compensator.share(e)
        integral = before + rises
        s = e if pid.derivative_on == "error" else -measured
        derivative = (Tf * derivative + Kc * pid.Td * (s - s_last)) / (Tf + own)
        s_last = s
        u = offset + P + integral + derivative
        if pid.output_limits is not None:
            low, high = pid.output_limits
            if pid.anti_windup == "clamp":
                if (u > high and rises > 0) or (u < low and rises < 0):
                    integral = before
                    u = offset + P + integral + derivative
                u = min(max(u, low), high)
            else:
                limited = min(max(u, low), high)
                if limited != u:
                    integral += own / (pid.tracking_time or pid.Ti) * (limited - u)
                u = limited
        due = k % loop.scan == 0
        if pid.compensator is not None and due:
            u, integral = compensator.output(u, e, offset + P + derivative, integral)
        # An output that stands at a limit, if only just, stays there.
        if pid.output_resolution > 0 and u not in (pid.output_limits or ()):
            u = offset + pid.output_resolution * round((u - offset) / pid.output_resolution)
            low, high = pid.output_limits or (-math.inf, math.inf)
            u = min(max(u, low), high)
        if not due:
            u = u_last
            integral, derivative, s_last = kept
        valve = loop.valve
        if isinstance(valve, wb.Ideal):
            x = u
        elif isinstance(valve, wb.Stenman):
            x = x if abs(u - x) <= valve.d else u
        elif isinstance(valve, wb.He):
            x = x if abs(u - x) <= valve.fs else u - math.copysign(valve.fd, u - x)
        elif isinstance(valve, wb.Kano):
            if not stands and (u - u_last) * came <= 0:
                stopped_at, stands = u_last, True
            if stands and -came * (u - stopped_at) > valve.S:
                came, stands = -came, False
            elif stands and came * (u - stopped_at) > valve.J:
                stands = False
            x = x if stands else u - came * ((valve.S - valve.J) / 2)
        else:
            ways = (valve.up, valve.down) if isinstance(valve, wb.Directional) else (valve, valve)
            up, down = ((law.b, 0.0) if isinstance(law, wb.Deadband) else (law.S, law.J) for law in ways)
            if not (moving and (u - u_last) * direction > 0):
                direction = 1 if u > x else -1
                S, J = up if direction > 0 else down
                moving = abs(u - x) > (S + J) / 2
            if moving:
                S, J = up if direction > 0 else down
                x = u - direction * ((S - J) / 2)
        u_last = u
        opened = sign * x
        if loop.characteristic is not None:
            c = math.log(loop.characteristic.rangeability) / 100
            opened = math.expm1(c * opened) / c
        v.append(opened + load[k])
        out["pv"].append(measured)
        out["op"].append(u)
        out["valve"].append(x)
        if isinstance(plant, wb.FOPDT):
            a = math.exp(-Ts / plant.time_constant)
            b = a ** (1 - f)
            y = a * y + plant.gain * ((1 - b) * past(k - m) + (b - a) * past(k - m - 1))
        else:
            y = y + plant.gain * Ts * ((1 - f) * past(k - m) + f * past(k - m - 1))
    out["final"] = [y + noise[n]]
    return out


def late_cycles(run: wb.Run, begin: float) -> tuple[float, float]:
    """Median period (s) and PV swing (EU) of a run's cycles from `begin` (s) on, upward turn to upward turn."""
    moves = np.diff(run.valve)
    at = np.flatnonzero(moves)
    turns = at[1:][(moves[at[1:]] > 0.0) & (moves[at[:-1]] < 0.0)] + 1
    turns = turns[run.time[turns] >= begin]
    swings = [np.ptp(run.pv[a:b]) for a, b in pairwise(turns)]
    return float(np.median(np.diff(run.time[turns]))), float(np.median(swings))


def as_arrays(n: int, *signals: Any) -> list[np.ndarray]:
    return [np.zeros(n + 1) if s is None else np.asarray(s, dtype=float) for s in signals]
