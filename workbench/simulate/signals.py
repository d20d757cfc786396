"""An experiment's profiles and noise as sampled signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.cascade import CascadeExperiment
from workbench.model.checks import instance
from workbench.model.experiment import Experiment, Noise, Profile, Ramp, Step
from workbench.model.loop import Loop
from workbench.model.record import FloatArray

__all__ = ["Signals", "noise_signal", "profile_signal", "sample_count", "signals"]

# Samples of one run: a run keeps about a dozen signals of this length in memory.
MOST = 20_000_000


@dataclass(frozen=True, eq=False)
class Signals:
    """An experiment as the kernel takes it: r (EU), load (%), noise (EU), each of shape (N + 1,), or a row for each."""

    r: FloatArray
    load: FloatArray
    noise: FloatArray

    @property
    def samples(self) -> int:
        """N."""
        return int(self.r.shape[-1]) - 1


def sample_count(duration: float, sample_time: float) -> int:
    """Return N = duration/sample_time, refused if off a whole number by more than 1e-9 relative, or above MOST."""
    ratio = duration / sample_time
    if not ratio <= MOST * (1.0 + 1e-9):
        limit = f"must be at most {MOST:,} samples of {sample_time:g} s"
        raise InvalidValue("Experiment.duration", f"{duration:g} s", limit)
    n = round(ratio)
    if n < 1 or abs(ratio - n) > 1e-9 * n:
        raise InvalidValue(
            "Experiment.duration", f"{duration:g} s", f"must be a whole number of samples of {sample_time:g} s"
        )
    return n


def profile_signal(parts: Sequence[Profile], n: int, sample_time: float) -> FloatArray:
    """Return the sum of the parts at samples 0 .. N, shape (N + 1,); a step at t has happened in that sample."""
    signal = np.zeros(n + 1)
    # Sample times k Ts may fall short of a step's time by rounding alone.
    time = np.arange(n + 1) * sample_time
    slack = 1e-9 * sample_time
    for part in parts:
        if isinstance(part, Step):
            signal[time >= part.at - slack] += part.size
        elif isinstance(part, Ramp):
            signal += part.size * np.clip((time - part.start) / (part.end - part.start), 0.0, 1.0)
        elif part.times is None:
            values = np.asarray(part.values)
            if values.size > n + 1:
                given = f"{values.size} values"
                raise InvalidValue("Series.values", given, f"must be at most one for each of the {n + 1} samples")
            signal[: values.size] += values
            signal[values.size :] += values[-1]
        else:
            held = np.searchsorted(np.asarray(part.times) - slack, time, side="right") - 1
            signal += np.where(held >= 0, np.asarray(part.values)[np.maximum(held, 0)], 0.0)
    return signal


def noise_signal(noise: Noise | None, n: int) -> FloatArray:
    """Return the measurement noise of samples 0 .. N, shape (N + 1,): `default_rng(seed).normal(0, sd, N + 1)`."""
    if noise is None or noise.sd == 0.0:
        return np.zeros(n + 1)
    return np.random.default_rng(noise.seed).normal(0.0, noise.sd, n + 1)


def signals(loop: Loop, experiment: Experiment) -> Signals:
    """Return the experiment's signals on the loop's samples, the load in OP's direction.

    Raises `InvalidValue` where these are no loop and experiment, the experiment has what a cascade alone has, the
    duration is no whole number of samples, or the stem offset is no resting state: the valve would not hold it, or OP
    cannot stand there.
    """
    instance(loop, Loop, "loop", "a Loop")
    instance(experiment, Experiment, "experiment", "an Experiment")
    if isinstance(experiment, CascadeExperiment):
        for name in ("primary_load", "secondary_noise"):
            if getattr(experiment, name) is not None:
                where, given = f"CascadeExperiment.{name}", getattr(experiment, name)
                raise InvalidValue(where, given, "must be None beside a Loop, which has none: simulate a Cascade")
    n = sample_count(experiment.duration, loop.sample_time)
    if abs(experiment.stem_offset) > loop.valve.hold:
        raise InvalidValue(
            "Experiment.stem_offset",
            f"{experiment.stem_offset:g} %",
            f"must be at most {loop.valve.hold:g} % in size, as this valve would not rest there",
        )
    limits = loop.controller.output_limits
    if limits is not None and not limits[0] <= experiment.stem_offset <= limits[1]:
        where, allowed = "Experiment.stem_offset", f"must lie within the output limits {limits}: OP rests there"
        raise InvalidValue(where, f"{experiment.stem_offset:g} %", allowed)
    return Signals(
        profile_signal(experiment.setpoint_parts, n, loop.sample_time),
        loop.direction * profile_signal(experiment.load_parts, n, loop.sample_time),
        noise_signal(experiment.noise, n),
    )
