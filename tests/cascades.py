"""A cascade as a scenario, random ones for property tests, and an independent simulator of them in plain Python."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st
from loops import numbers

import workbench as wb

TWO_LOOPS = """\
title: Two loops
cascade:
  primary:
    plant: {type: fopdt, gain: 1.2, time_constant: 30 s, dead_time: 5 s}
    controller: {Kc: 1.5, Ti: 40 s}
    sample_time: 5 s
  secondary:
    plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
    valve: {type: stenman, d: 1.0}
    controller: {Kc: 0.5, Ti: 5 s}
    sample_time: 1 s
experiment: {duration: 200 s, setpoint: {step: 2, at: 0 s}}
cases:
  - {name: As found}
analyze: {limit_cycle: false}
"""


def flow_and_temperature(
    primary: wb.PID | None = None, secondary: wb.PID | None = None, *, valve: Any = None, every: int = 5, **options: Any
) -> wb.Cascade:
    """A temperature over a flow whose valve sticks: flow in EU per %, temperature in EU per EU of flow."""
    inner = wb.Loop(wb.FOPDT(1.0, 3.0, 1.0), valve or wb.Stenman(1.0), secondary or wb.PID(0.5, 5.0), sample_time=1.0)
    outer = wb.Loop(wb.FOPDT(1.2, 60.0, 10.0), wb.Ideal(), primary or wb.PID(1.5, 80.0), sample_time=float(every))
    return wb.Cascade(primary=outer, secondary=inner, **options)


class _Pid:
    """The PID law with clamping, one call a sample."""

    def __init__(self, pid: wb.PID, Ts: float) -> None:
        self.pid, self.Ts = pid, Ts
        self.integral = self.derivative = self.s = 0.0

    def __call__(self, r: float, y: float, *, integrate: bool = True) -> tuple[float, int]:
        pid, Ts = self.pid, self.Ts
        Kc, Tf = pid.Kc if pid.action == "reverse" else -pid.Kc, pid.Td / pid.derivative_filter
        e = r - y
        s = e if pid.derivative_on == "error" else -y
        self.derivative = (Tf * self.derivative + Kc * pid.Td * (s - self.s)) / (Tf + Ts)
        self.s = s
        rises = Kc * Ts / pid.Ti * e if integrate else 0.0
        rest = Kc * (pid.setpoint_weight * r - y) + self.derivative
        u = rest + self.integral + rises
        low, high = pid.output_limits or (-math.inf, math.inf)
        if not ((u > high and rises > 0.0) or (u < low and rises < 0.0)):
            self.integral += rises
        u = rest + self.integral
        return min(max(u, low), high), int(u > high) - int(u < low)


def _lagged(tau1: float, tau2: float, h: float) -> float:
    """The integral over 0..h of exp(-(h - s)/tau1) exp(-s/tau2)."""
    if tau1 == tau2:
        return h * math.exp(-h / tau1)
    return (math.exp(-h / tau2) - math.exp(-h / tau1)) / (1.0 / tau1 - 1.0 / tau2)


def independent_cascade(cascade: wb.Cascade, given: Any) -> dict[str, list[float]]:
    """The cascade written once more for self-regulating plants and Stenman, two-parameter and ideal valves.

    The chain from valve to the primary's PV by the closed form of two first-order lags, in two steps where the dead
    time ends within a sample. `margin`: the least distance of any stem decision from its guard.
    """
    inner, outer, Ts = cascade.secondary, cascade.primary, cascade.secondary.sample_time
    K2, t2, K1, t1 = inner.plant.gain, inner.plant.time_constant, outer.plant.gain, outer.plant.time_constant
    first, second = _Pid(outer.controller, outer.sample_time), _Pid(inner.controller, Ts)
    held: list[float] = []
    out: dict[str, list[float]] = {name: [] for name in ("y1", "u1", "r2", "y2", "u2", "x")}
    w = y1 = y2 = extra = x = u1 = u_last = 0.0
    moving, limit, margin = 0, 0, math.inf

    def past(j: int) -> float:
        return held[j] if j >= 0 else 0.0

    def split(theta: float) -> tuple[int, float]:
        m = math.floor(theta / Ts + 1e-9)
        f = theta / Ts - m
        return m, 0.0 if f < 1e-9 else f

    def over(h: float, w: float, y: float, v: float) -> tuple[float, float]:
        """Both lags over a time h with the input v held."""
        a1, a2 = math.exp(-h / t1), math.exp(-h / t2)
        cross = K1 / t1 * _lagged(t1, t2, h)
        return a2 * w + (1 - a2) * K2 * v, a1 * y + cross * w + (K1 * (1 - a1) - cross) * K2 * v

    for k in range(given.samples):
        seen = y1 + extra
        if k % cascade.every == 0:
            kick = outer.controller.Kc * (1 if outer.controller.action == "reverse" else -1) / outer.controller.Ti
            kick *= given.r[k] - (seen + given.noise1[k])
            push = cascade.scale * (1 if inner.controller.action == "reverse" else -1) * inner.controller.Kc
            free = cascade.anti_windup == "none" or limit * kick * push <= 0.0
            u1, _ = first(given.r[k], seen + given.noise1[k], integrate=free)
        r2 = cascade.scale * u1
        u, limit = second(r2, y2 + given.noise2[k])
        valve = inner.valve
        if isinstance(valve, wb.Ideal):
            x = u
        elif isinstance(valve, wb.Stenman):
            margin = min(margin, abs(abs(u - x) - valve.d))
            x = x if abs(u - x) <= valve.d else u
        else:
            if not (moving and (u - u_last) * moving > 0):
                margin = min(margin, abs(abs(u - x) - (valve.S + valve.J) / 2))
                moving = (1 if u > x else -1) if abs(u - x) > (valve.S + valve.J) / 2 else 0
            else:
                margin = min(margin, abs(u - u_last))
            if moving:
                x = u - moving * ((valve.S - valve.J) / 2)
        u_last = u
        held.append(x + given.load[k])
        for name, value in zip(out, (seen, u1, r2, y2, u, x), strict=True):
            out[name].append(value)
        m, f = split(inner.plant.dead_time)
        a, b = math.exp(-Ts / t2), math.exp(-(1 - f) * Ts / t2)
        y2 = a * y2 + K2 * ((1 - b) * past(k - m) + (b - a) * past(k - m - 1))
        m, f = split(inner.plant.dead_time + outer.plant.dead_time)
        w, y1 = over((1 - f) * Ts, *over(f * Ts, w, y1, past(k - m - 1)), past(k - m))
        m, f = split(outer.plant.dead_time)
        a, b = math.exp(-Ts / t1), math.exp(-(1 - f) * Ts / t1)
        near, far = (float(given.disturbance[j]) if j >= 0 else 0.0 for j in (k - m, k - m - 1))
        extra = a * extra + K1 * ((1 - b) * near + (b - a) * far)
    out["margin"] = [margin]
    return out


@st.composite
def cascades(draw: st.DrawFn) -> wb.Cascade:
    def pid(gain: float) -> wb.PID:
        limited = draw(st.booleans())
        return wb.PID(
            Kc=draw(numbers(0.1, gain)),
            Ti=draw(numbers(3.0, 90.0)),
            Td=draw(st.sampled_from([0.0, 1.7])),
            derivative_on=draw(st.sampled_from(["error", "pv"])),
            setpoint_weight=draw(st.sampled_from([1.0, 0.3])),
            action=draw(st.sampled_from(["reverse", "reverse", "direct"])) if limited else "reverse",
            output_limits=(-draw(numbers(0.5, 5.0)), draw(numbers(0.5, 5.0))) if limited else None,
        )

    inner = wb.Loop(
        wb.FOPDT(draw(numbers(0.3, 2.0)), draw(numbers(1.0, 20.0)), draw(numbers(0.0, 5.0))),
        draw(
            st.one_of(
                st.just(wb.Ideal()),
                st.builds(wb.Stenman, d=numbers(0.1, 2.0)),
                st.builds(wb.Choudhury, S=numbers(0.1, 3.0), J=numbers(0.0, 3.0)),
            )
        ),
        pid(1.0),
        draw(st.sampled_from([0.5, 1.0])),
    )
    every = draw(st.sampled_from([1, 2, 5]))
    tau1 = draw(st.one_of(numbers(5.0, 60.0), st.just(inner.plant.time_constant)))
    plant = wb.FOPDT(draw(numbers(0.3, 2.0)), tau1, draw(numbers(0.0, 9.0)))
    outer = wb.Loop(plant, wb.Ideal(), pid(2.0), every * inner.sample_time)
    scale = draw(st.sampled_from([1.0, 0.25, -1.0]))
    return wb.Cascade(outer, inner, scale, draw(st.sampled_from(["clamp", "none"])))


@st.composite
def cascade_experiments(draw: st.DrawFn, duration: float = 150.0) -> wb.CascadeExperiment:
    noise = st.one_of(st.none(), st.builds(wb.Noise, sd=numbers(0.0, 0.1), seed=st.integers(0, 9)))
    return wb.CascadeExperiment(
        duration=duration,
        setpoint=wb.Step(draw(numbers(-4.0, 4.0)), at=draw(st.sampled_from([0.0, 7.0]))),
        load=draw(st.one_of(st.none(), st.builds(wb.Step, size=numbers(-2.0, 2.0), at=numbers(0.0, 99.0)))),
        noise=draw(noise),
        primary_load=draw(st.one_of(st.none(), st.builds(wb.Step, size=numbers(-2.0, 2.0), at=numbers(0.0, 99.0)))),
        secondary_noise=draw(noise),
    )
