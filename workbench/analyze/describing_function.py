"""`wb.describing_function`: does L(jw) meet -1/N(A), with which amplitude and period, and if not, how far is it off."""

from __future__ import annotations

import math

import numpy as np

from workbench.analyze.frequency import linear_stable, loop_response
from workbench.analyze.loci import Approach, Meeting, closest_approach, first_meeting, meetings
from workbench.analyze.valve_loci import locus_pieces
from workbench.errors import InvalidValue
from workbench.model.analyses import ComplexArray, Crossing, DescribingFunction
from workbench.model.checks import instance
from workbench.model.loop import Loop
from workbench.model.numbers import given
from workbench.model.plant import FOPDT
from workbench.model.record import FloatArray

__all__ = ["describing_function", "meeting_gain"]

# Frequencies of the result (evenly spaced in log) and of the search (more, and dense enough for the dead time).
SHOWN = 1500
SEARCHED = 4000
LONGEST_SEARCH = 20000


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # the verdict says where nothing is left of a locus
def describing_function(loop: Loop, *, sampling_delay: bool = False) -> DescribingFunction:
    """Return the describing-function analysis of a loop: loci, all crossings, and the distance where there is none.

    A cycle is predicted where `1 + N(A) L(jw) = 0`, N the valve's describing function (`analyze.valve_loci`) and L
    controller times plant, with dead time and derivative filter exact, up to the Nyquist frequency pi/Ts. L is
    continuous unless `sampling_delay`, which takes the sampled loop's own response, hold included. Output limits, OP's
    resolution, noise and load are left out, a curved characteristic counts by its gain at the operating point, and the
    method is an approximation: the exact verdict is `limit_cycle`'s.

    Stenman's and He's loci have several pieces (two families of staircases, see `valve_loci.staircase_response`), whose
    first indices are in `breaks`; a valve without friction has the single point -1, and cycles in a linear loop are
    none of this method's business. Raises `InvalidValue` where the controller has no ideal equivalent, or the valve no
    describing function (`valve_loci.no_locus`), and for a controller with a compensator, which L(jw) does not hold.
    """
    instance(loop, Loop, "loop", "a Loop")
    instance(sampling_delay, bool, "describing_function.sampling_delay", "True or False")
    if loop.controller.compensator is not None:
        allowed = "must be None: the method holds for the loop without it (`limit_cycle` follows the loop with it)"
        raise InvalidValue("PID.compensator", type(loop.controller.compensator).__name__, allowed)
    stable = linear_stable(loop)
    shown = _frequencies(loop, SHOWN)

    def response(frequency: FloatArray) -> ComplexArray:
        return loop_response(loop, frequency, sampling_delay=sampling_delay)[0]

    L = response(shown)
    pieces = locus_pieces(loop.valve)
    if not pieces:
        gap = np.abs(L + 1.0)
        nearest = int(np.argmin(gap))
        return DescribingFunction(
            loop=loop,
            amplitudes=np.array([1.0]),
            N=np.array([1.0 + 0.0j]),
            locus=np.array([-1.0 + 0.0j]),
            frequencies=shown,
            L=L,
            crossings=(),
            distance=float(gap[nearest]),
            distance_amplitude=math.nan,
            distance_frequency=float(shown[nearest]),
            predicts_cycle=False,
            amplitude=math.nan,
            period=math.nan,
            pv_amplitude=math.nan,
            linear_stable=stable,
            verdict=_frictionless(stable) + _left_out(loop),
        )
    amplitudes = [piece.amplitude(piece.points) for piece in pieces]
    N = np.concatenate([piece.N(A) for piece, A in zip(pieces, amplitudes, strict=True)])
    locus: ComplexArray = np.divide(-1.0, N)
    search = _search_frequencies(loop)
    met = meetings(response, search, pieces)
    crossings = tuple(_crossing(loop, one, sampling_delay) for one in met)
    lasting = [one for one in crossings if one.stable]
    predicted = lasting[-1] if lasting else None
    if crossings:
        at = predicted or crossings[-1]
        approach = Approach(0.0, at.amplitude, at.frequency)
    else:
        approach = closest_approach(response, search, pieces)
    return DescribingFunction(
        loop=loop,
        amplitudes=np.concatenate(amplitudes),
        N=N,
        locus=locus,
        frequencies=shown,
        L=L,
        crossings=crossings,
        distance=approach.distance,
        distance_amplitude=approach.amplitude,
        distance_frequency=approach.frequency,
        predicts_cycle=bool(crossings),
        amplitude=predicted.amplitude if predicted else math.nan,
        period=predicted.period if predicted else math.nan,
        pv_amplitude=predicted.pv_amplitude if predicted else math.nan,
        linear_stable=stable,
        verdict=_verdict(loop, crossings, predicted, approach, stable) + _left_out(loop),
        breaks=tuple(np.cumsum([0] + [A.size for A in amplitudes[:-1]]).tolist()),
    )


def meeting_gain(loop: Loop) -> float:
    """Return the least factor on the controller's gain at which the loci of `describing_function` meet; inf for none.

    Raises `InvalidValue` where the controller has no ideal equivalent.
    """
    return first_meeting(lambda w: loop_response(loop, w)[0], _search_frequencies(loop), locus_pieces(loop.valve))


def _frequencies(loop: Loop, count: int) -> FloatArray:
    """Log-spaced up to Nyquist, from well below the slowest time in the loop."""
    times = [loop.executed.sample_time, loop.plant.dead_time]
    if isinstance(loop.plant, FOPDT):
        times.append(loop.plant.time_constant)
    terms = loop.controller.ideal_terms()
    times += [t for t in (terms.Ti, abs(terms.Td)) if math.isfinite(t)]
    highest = math.pi / loop.executed.sample_time
    return np.geomspace(1e-4 / max(times), highest * (1.0 - 1e-9), count)


def _search_frequencies(loop: Loop) -> FloatArray:
    """The shown range more finely, and linearly where the dead time turns the phase faster than log spacing follows."""
    grid = _frequencies(loop, SEARCHED)
    Ts = loop.executed.sample_time
    turns = math.pi / Ts * (loop.plant.dead_time + Ts)
    even = np.linspace(0.0, grid[-1], min(int(turns / 0.05) + 2, LONGEST_SEARCH))[1:]
    return np.unique(np.concatenate([grid, even]))


def _crossing(loop: Loop, met: Meeting, sampling_delay: bool) -> Crossing:
    G = loop_response(loop, np.array([met.frequency]), sampling_delay=sampling_delay)[1]
    return Crossing(
        amplitude=met.amplitude,
        frequency=met.frequency,
        period=2.0 * math.pi / met.frequency,
        pv_amplitude=met.amplitude * abs(met.N) * float(abs(G[0])),
        stable=met.stable,
    )


def _frictionless(stable: bool) -> str:
    if stable:
        return "The valve does not stick and the loop is stable, so no cycle is predicted."
    return (
        "The valve does not stick, but the loop is unstable by its tuning alone; "
        "the describing function has nothing to add."
    )


def _verdict(
    loop: Loop, crossings: tuple[Crossing, ...], predicted: Crossing | None, approach: Approach, stable: bool
) -> str:
    if loop.controller.ideal_terms().Kc == 0.0:
        return "The controller's gain is 0, so there is no feedback and no cycle is predicted."
    linear = "" if stable else "; the loop would be unstable with an ideal valve too"
    if predicted is not None:
        limits = loop.controller.output_limits
        out = limits is not None and predicted.amplitude > max(-limits[0], limits[1])
        op, pv = given(2.0 * predicted.amplitude, 3), given(2.0 * predicted.pv_amplitude, 3)
        period = given(predicted.period, 3)
        return (
            f"The loci cross: a cycle with a period of {period} s is predicted, OP swinging by {op} % "
            f"and PV by {pv} EU peak to peak{linear}"
            + ("; the output limits, left out here, would not let OP swing that far." if out else ".")
        )
    if crossings:
        least = crossings[0]
        return (
            f"The loci cross only where a cycle would not last (OP amplitude {given(least.amplitude, 3)} %, period "
            f"{given(least.period, 3)} s): smaller swings are predicted to die out and larger ones to grow{linear}."
        )
    if math.isinf(approach.distance):
        return f"The numbers of this loop are too large or too small for its loci to be calculated{linear}."
    period = given(2.0 * math.pi / approach.frequency, 3)
    return (
        f"The loci do not cross, so no cycle is predicted; they come as close as {given(approach.distance, 3)} at an "
        f"OP amplitude of {given(approach.amplitude, 3)} % and a period of {period} s{linear}."
    )


def _left_out(loop: Loop) -> str:
    """A sentence on what else in this loop the loci do not show."""
    resolution = loop.controller.output_resolution
    words = f" OP's resolution of {given(resolution, 3)} % is left out here." if resolution > 0.0 else ""
    if loop.characteristic is not None:
        words += " It holds for the gain at the operating point: the curve of the characteristic is left out."
    if loop.scan > 1 and not loop.valve.sticks_at_once and loop.valve.stick_band > 0.0:
        words += " That OP stands between the controller's executions, where this stem sticks, is left out."
    return words
