"""Which sign the plant's gain must have for the controller's action to be feedback, read from the record."""

from __future__ import annotations

import numpy as np

from workbench.model.record import FloatArray, Record

__all__ = ["control_error", "feedback", "gain_sign", "only_answers"]

# Share of OP's moves that error and its change must explain for the controller's action to count as known.
CLEAR = 0.1
# Proportional and integral action have one sign; where the weaker is against the stronger by more, it was no PI.
AGAINST = 0.25
CLOSED = 0.5  # share of OP's moves that they explain where OP goes no way of its own


def control_error(record: Record) -> FloatArray:
    """Return SP - PV, EU, shape (N,); where SP was not recorded it counts as constant at PV's mean."""
    error: FloatArray = (record.pv.mean() if record.sp is None else record.sp) - record.pv
    return error


def gain_sign(record: Record) -> float:
    """Return the sign that the plant's gain must have for the controller's action to be feedback, 0 where unclear.

    The controller's inverse would otherwise pass for a plant.
    """
    explained, main, other = feedback(record)
    if explained < CLEAR or other * np.sign(main) < -AGAINST * abs(main):
        return 0.0
    return float(np.sign(main))


def only_answers(record: Record) -> bool:
    """Return whether OP moves as the controller answers PV alone: no setpoint moves, and nobody moves OP by hand.

    What disturbs PV is then all that moves OP, and a linear plant is told from the disturbance by nothing but the
    colour that this is taken to have (L. Ljung, "System identification", 2nd ed., Prentice Hall 1999, 13.4).
    """
    still = record.sp is None or bool(np.ptp(record.sp) == 0.0)
    return still and feedback(record)[0] >= CLOSED


def feedback(record: Record) -> tuple[float, float, float]:
    """Return (share of OP's moves that the error explains, the stronger and the weaker action in a common scale).

    The moves of OP are regressed on those of the error (proportional action) and on the error (integral action).
    """
    error = control_error(record)
    moves = np.diff(record.op)
    causes = np.column_stack([np.diff(error), error[1:] - error[1:].mean()])
    moves = moves - moves.mean()
    scale = np.sqrt((causes**2).sum(axis=0))
    if not (scale > 0.0).all() or not float(moves @ moves) > 0.0:
        return 0.0, 0.0, 0.0
    terms, *_ = np.linalg.lstsq(causes / scale, moves, rcond=None)
    explained = 1.0 - float(((moves - causes / scale @ terms) ** 2).sum()) / float(moves @ moves)
    main, other = sorted(terms.tolist(), key=abs, reverse=True)
    return explained, float(main), float(other)
