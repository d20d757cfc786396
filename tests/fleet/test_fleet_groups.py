"""Loops that oscillate together, and which is the root."""

from __future__ import annotations

import numpy as np

from workbench.fleet.groups import grouped, untold
from workbench.model.fleet import FleetRow


def cycling(
    name: str, turns: np.ndarray, period: float = 300.0, first: int = 1000, step: float = 256.0, **more: object
):
    phases = (np.rint(turns * 256.0).astype(int) % 256).astype(np.uint8).tobytes()
    given = {"verdict": "no_stiction", "oscillation_index": 0.8, "predicts": 0.0, "swing": 0.8, **more}
    return FleetRow(name, oscillates=True, period=period, phase_step=step, phase_first=first, phases=phases, **given)


def wandering(seed: int, n: int = 200) -> np.ndarray:
    """The phase of a cycle that is no clock, turns."""
    return np.cumsum(np.random.default_rng(seed).normal(0.7, 0.1, n))


def test_locked_loops_are_a_group_with_the_sticking_one_first() -> None:
    base = wandering(0)
    jitter = np.random.default_rng(5).normal(0.0, 0.03, base.size)
    rows = [
        cycling("driven", base + 0.3, oscillation_index=0.99),
        cycling("late", base + 0.6 + jitter, period=310.0),
        cycling("root", base, verdict="stiction", predicts=0.2),
        cycling("weaker", base + 0.1, verdict="stiction", predicts=0.1),
        cycling("swings", base + 0.1, verdict="stiction", predicts=0.25, swing=0.1),
        cycling("alone", wandering(1)),
        FleetRow("quiet", verdict="stiction", predicts=0.9),
    ]
    (group,) = grouped(rows)
    assert group.members[0] == "root"
    assert set(group.members) == {"root", "driven", "late", "weaker", "swings"}
    assert group.sticky
    assert group.locked[0] == 1.0
    assert all(lock > 0.9 for lock in group.locked)
    assert group.period == 300.0


def test_without_a_sticking_valve_the_strongest_oscillation_is_first() -> None:
    base = wandering(0)
    (group,) = grouped([cycling("b", base, oscillation_index=0.5), cycling("a", base, oscillation_index=0.9)])
    assert group.members == ("a", "b")
    assert not group.sticky


def test_few_cycles_must_be_locked_more_closely() -> None:
    def pair(n: int) -> tuple[object, ...]:
        base = wandering(0, n)
        apart = base + np.linspace(0.0, 0.38, n)  # coherence about 0.78
        return grouped([cycling("a", base), cycling("b", apart)])

    assert len(pair(200)) == 1  # 171 cycles
    assert pair(24) == ()  # 20 cycles


def test_too_few_cycles_to_tell_is_no_word_of_cycling_alone() -> None:
    base = wandering(0)

    def names(hours: float, **more: object) -> set[str]:
        rows = [cycling("a", base, hours=hours), cycling("b", base, period=320.0, hours=9.0, **more)]
        return set(untold(rows, grouped(rows) if hours > 2.0 else ()))

    assert names(1.0) == {"a", "b"}  # 12 cycles of a
    assert names(9.0) == set()
    assert set(untold([cycling("a", base, hours=1.0), cycling("c", base, period=700.0, hours=1.0)], ())) == set()
    assert set(untold([cycling("a", base, hours=1.0)], ())) == set()


def test_the_same_period_alone_is_no_group() -> None:
    assert grouped([cycling(str(k), wandering(k)) for k in range(60)]) == ()


def test_another_period_is_no_group_even_with_locked_phases() -> None:
    base = wandering(0)
    assert grouped([cycling("a", base), cycling("b", base, period=400.0)]) == ()


def test_steps_and_days_that_differ() -> None:
    base = wandering(0)
    coarse = cycling("coarse", base[::2], first=500, step=512.0)
    (group,) = grouped([cycling("fine", base), coarse])
    assert group.locked[1] > 0.99
    # Of another day: no instant is common to both.
    assert grouped([cycling("fine", base), cycling("other", base, first=99_000)]) == ()
    # An odd first instant of the finer one.
    (group,) = grouped([cycling("fine", base[1:], first=1001), coarse])
    assert group.locked[1] > 0.99


def test_many_loops_in_blocks_and_in_any_order() -> None:
    rows = []
    for k in range(300):
        base = wandering(k)
        rows += [
            cycling(f"r{k}", base, period=200.0 + k, verdict="stiction"),
            cycling(f"d{k}", base + 0.2, period=200.0 + k),
        ]
    found = grouped(rows)
    assert len(found) == 300
    assert all(group.members == (f"r{group.members[0][1:]}", f"d{group.members[0][1:]}") for group in found)
    assert grouped(rows[::-1]) == found


def test_nothing_to_group() -> None:
    assert grouped([]) == ()
    assert grouped([cycling("a", wandering(0))]) == ()
