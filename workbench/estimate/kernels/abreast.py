"""Many stems side by side: their paths and the sums of their responses, `LANES` of them in one pass over a record.

The compiler makes vector instructions of the loops over lanes. For that each decision is a choice between two values
and all numbers of the lanes stand in one array at constant distances. What a stem is and what is summed is told where
one stem is taken alone, in `path_kernel.band_path` and `output_error.oe_cost`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import (
    FIT,
    SSE,
    least,
    own_sums,
    plant_terms,
    start_products,
    start_rests,
    transient_at,
)
from workbench.simulate.compiled import compiled, copy, place, written_out

__all__ = ["LANES", "LINE", "ROW", "walk_bands"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LANES = 32
STRIDE = 4  # samples of a lane at a time, its numbers in registers
CHUNK = 32  # samples of all lanes at a time, in the fastest memory
# A lane's numbers: its valve (S and J, and which of their edges is asked for), its stem (where it was led, in which
# sense, whether it moves, OP's last value, the edge met, slips), its plant, response and last input, start and
# transient, and the sums of the response and of its products.
(_BACK, _ON, _ALONG_J) = range(0, 3 * LANES, LANES)
(_LED, _SENSE, _MOTION, _LAST, _EDGE, _SLIPS) = range(3 * LANES, 9 * LANES, LANES)
(_POLE, _C0, _C1, _GROWS, _S, _W, _G, _R) = range(9 * LANES, 17 * LANES, LANES)
(_SUM, _SS, _SY, _SG, _SR) = range(17 * LANES, 22 * LANES, LANES)
WIDTH = 22 * LANES
# A line that is walked: where it starts in S and J, along which of them, up to where, its least and largest step, the
# stem's start and the plant.
BEGIN_S, BEGIN_J, ALONG, END, LEAST, MOST, FIRST, SENSE, TAU, THETA = range(10)
LINE = 10
# Columns of a row that `walk_bands` writes: S, J, cost, slips, and the line that it is of.
ROW = 5
NEVER = 1e300  # % of OP
RAMP = 1e-9  # of OP, a sample: OP before a stem's first slip, so that it moves when the slip comes
GONE = 1e-13  # of a start or transient: it counts no more
WORTH = 1.5  # steps left of a line, as long as its last, for which an idle lane takes the further half of them


@written_out
def _stem(op: Floats, first: int, lanes: Floats, x: Floats, at: int, count: int) -> None:
    """`count` samples of the lanes' stems, OP's from `first` on, written from x's row `at`: `path_kernel.band_path`.

    Without branches, and each choice has one comparison: such as are made of several are slow where vectors are of four
    numbers.
    """
    there, here = place(first * LANES), place(at * LANES)
    for j in range(LANES):
        S, J, along_j = lanes[_BACK + j], lanes[_ON + j], lanes[_ALONG_J + j] > 0.0
        offset, edge_on, edge_back = 0.5 * (S - J), J if along_j else NEVER, NEVER if along_j else S
        led, sense, motion, last = lanes[_LED + j], lanes[_SENSE + j], lanes[_MOTION + j], lanes[_LAST + j]
        edge, slips = lanes[_EDGE + j], lanes[_SLIPS + j]
        for i in range(count):
            v = op[there + place(i * LANES + j)]
            goes_on = motion * (v - last) > 0.0
            # A stem that goes on is led as one that slips on is, over an edge of no size.
            on = NEVER if goes_on else (v - led) * sense
            size = on if on > edge_on else NEVER
            edge = size if size < edge else edge
            size = -on if on < -edge_back else NEVER
            edge = size if size < edge else edge
            slip = 0.0 if goes_on else (1.0 if on > J else 0.0)
            slips += 1.0 if on < -S else slip
            led = v if on > J else led
            led = v if on < -S else led
            motion = sense if on > J else 0.0
            motion = -sense if on < -S else motion
            sense = -sense if on < -S else sense
            last = v
            x[here + place(i * LANES + j)] = led - sense * offset
        lanes[_LED + j], lanes[_SENSE + j], lanes[_MOTION + j], lanes[_LAST + j] = led, sense, motion, last
        lanes[_EDGE + j], lanes[_SLIPS + j] = edge, slips


@compiled
def _stems(op: Floats, first: int, lanes: Floats, x: Floats, at: int, rows: int) -> None:
    """The lanes' stems in `rows` samples."""
    i = 0
    while i + STRIDE <= rows:
        _stem(op, first + i, lanes, x, at + i, STRIDE)
        i += STRIDE
    while i < rows:
        _stem(op, first + i, lanes, x, at + i, 1)
        i += 1


@written_out
def _sum(y: Floats, first: int, w: Floats, added: Floats, at: int, lanes: Floats, count: int, late: bool) -> None:
    """`count` samples of the lanes' responses to w, from its row `at` on, and their products with PV from `first` on.

    added: what start columns are set on by. late: start and transient have died out.
    """
    there, here = place(first), place(at * LANES)
    for j in range(LANES):
        pole, c0, c1, grows = lanes[_POLE + j], lanes[_C0 + j], lanes[_C1 + j], lanes[_GROWS + j]
        s, before, g, r = lanes[_S + j], lanes[_W + j], lanes[_G + j], lanes[_R + j]
        total, ss, sy, sg, sr = lanes[_SUM + j], lanes[_SS + j], lanes[_SY + j], lanes[_SG + j], lanes[_SR + j]
        for i in range(count):
            now = w[here + place(i * LANES + j)]
            total += s
            ss += s * s
            sy += s * y[there + place(i)]
            if not late:
                g += added[here + place(i * LANES + j)]
                sg += s * g
                sr += s * r
                g *= pole
                r = r * pole + grows
            s = pole * s + (c0 * now + c1 * before)
            before = now
        lanes[_S + j], lanes[_W + j] = s, before
        lanes[_SUM + j], lanes[_SS + j], lanes[_SY + j] = total, ss, sy
        if not late:
            lanes[_G + j], lanes[_R + j], lanes[_SG + j], lanes[_SR + j] = g, r, sg, sr


@compiled
def _sums(y: Floats, first: int, w: Floats, added: Floats, lanes: Floats, begin: int, end: int, late: bool) -> None:
    """The lanes' sums in rows [begin, end) of w, whose row 0 stands at PV's sample `first`."""
    i = begin
    while i + STRIDE <= end:
        if late:
            _sum(y, first + i, w, added, i, lanes, STRIDE, True)
        else:
            _sum(y, first + i, w, added, i, lanes, STRIDE, False)
        i += STRIDE
    while i < end:
        _sum(y, first + i, w, added, i, lanes, 1, False)
        i += 1


@compiled
def _filtered(a: Floats, x: Floats, w: Floats, count: int) -> None:
    """Filter `count` rows of x, which stand behind a.size - 1 earlier ones, by a, which is not (1,)."""
    p, n, q = a.size - 1, count * LANES, min(a.size - 1, 4)
    # As the rows stand one behind the other, a sample earlier is LANES numbers earlier in all of them.
    now, one, two = x[p * LANES :], x[max(p - 1, 0) * LANES :], x[max(p - 2, 0) * LANES :]
    three, four = x[max(p - 3, 0) * LANES :], x[max(p - 4, 0) * LANES :]
    if q == 1:
        for k in range(n):
            w[k] = now[k] + a[1] * one[k]
    elif q == 2:
        for k in range(n):
            w[k] = now[k] + a[1] * one[k] + a[2] * two[k]
    elif q == 3:
        for k in range(n):
            w[k] = now[k] + a[1] * one[k] + a[2] * two[k] + a[3] * three[k]
    else:
        for k in range(n):
            w[k] = now[k] + ((a[1] * one[k] + a[2] * two[k]) + (a[3] * three[k] + a[4] * four[k]))
    while q + 4 <= p:
        one, two = x[(p - q - 1) * LANES :], x[(p - q - 2) * LANES :]
        three, four = x[(p - q - 3) * LANES :], x[(p - q - 4) * LANES :]
        b, c, d, e = a[q + 1], a[q + 2], a[q + 3], a[q + 4]
        for k in range(n):
            w[k] += (b * one[k] + c * two[k]) + (d * three[k] + e * four[k])
        q += 4
    while q < p:
        q += 1
        one = x[(p - q) * LANES :]
        for k in range(n):
            w[k] += a[q] * one[k]


class _Room(NamedTuple):
    """What the lanes work in, T samples with some before the record so that strides end where samples begin to count.

    op: T rows of LANES, each lane's OP, late by its plant's dead time; y: (T,). x: CHUNK rows behind p earlier ones; w:
    CHUNK rows, filtered; added: CHUNK rows, what start columns are set on by. held: by how many rows a lane's first
    slip is preceded; bases: its stem in those of them that are in the record; kept: the start and dead time that op
    stands for. starts: when, and by what, a lane's start column is set on; after: its transient from the first sample
    that counts on. products: those of `start_products`.
    """

    op: Floats
    y: Floats
    lanes: Floats
    x: Floats
    w: Floats
    added: Floats
    held: Ints
    bases: Floats
    kept: Floats
    begins: Ints
    starts: Floats
    after: Floats
    products: Floats


def _room(y: Floats, a: Floats, skip: int) -> _Room:
    p, lead = a.size - 1, -skip % STRIDE
    total = lead + y.size
    return _Room(
        op=np.zeros((total + STRIDE) * LANES),
        y=np.concatenate([np.zeros(lead), y]),
        lanes=np.zeros(WIDTH),
        x=np.zeros((p + CHUNK) * LANES),
        w=np.zeros(CHUNK * LANES),
        added=np.zeros(CHUNK * LANES),
        held=np.zeros(LANES, np.int64),
        bases=np.zeros(LANES),
        kept=np.full((LANES, 3), np.nan),
        begins=np.full(LANES, -1),
        starts=np.zeros((LANES, p + 1)),
        after=np.zeros(LANES),
        products=np.zeros((LANES, 5, 4)),
    )


@compiled
def _ramp(op: Floats, first: int, sense: float) -> float:
    """By how much OP creeps up to a first slip, a sample, so that the stem is led there when the slip comes."""
    size: float = RAMP * (1.0 + abs(op[first])) * sense
    return size


@compiled
def _lead_in(room: _Room, low: int, high: int, op: Floats, start: tuple[int, float, int]) -> None:
    """Write OP of the lanes from `low` up to `high`; start: first slip, how OP creeps up to it, and dead time."""
    first, ramp, delay = start
    lead = room.y.size - op.size
    begin = lead + delay + first
    for j in range(low, high):
        room.kept[j, 0], room.kept[j, 1], room.kept[j, 2] = first, ramp, delay
    for t in range(room.y.size):
        value = op[t - lead - delay] if t >= begin else op[first] - ramp * (begin - t)
        for j in range(t * LANES + low, t * LANES + high):
            room.op[j] = value


@written_out
def _enter(
    room: _Room,
    j: int,
    op: Floats,
    band: tuple[float, float],
    along: int,
    start: tuple[int, float],
    delay: int,
) -> bool:
    """Put a valve (S, J) into lane j; return whether its stem slips at all.

    start: its first slip and the sense of that, -1 for a stem that rests in the middle of its band (see
    `path_kernel.band_path`). along: the edge asked for, 1 of J, 0 of S. delay: whole samples of the plant's dead time.
    """
    S, J = band
    first, sense = start
    base = 0.0
    if first < 0:
        first = 0
        while first < op.size and abs(op[first] - op[0]) <= 0.5 * (S + J):
            first += 1
        if first == op.size:
            return False
        sense = 1.0 if op[first] > op[0] else -1.0
        base = op[0]
    lanes, lead = room.lanes, room.y.size - op.size
    begin = lead + delay + first
    ramp = _ramp(op, first, sense)
    if not (room.kept[j, 0] == first and room.kept[j, 1] == ramp and room.kept[j, 2] == delay):
        _lead_in(room, j, j + 1, op, (first, ramp, delay))
    room.held[j], room.bases[j] = begin, base
    lanes[_BACK + j], lanes[_ON + j], lanes[_ALONG_J + j] = S, J, along
    lanes[_LED + j], lanes[_LAST + j] = op[first] - ramp * begin, op[first] - ramp * (begin + 1.0)
    lanes[_SENSE + j], lanes[_MOTION + j], lanes[_EDGE + j], lanes[_SLIPS + j] = sense, sense, NEVER, 1.0
    return True


@compiled
def _drive(
    room: _Room,
    j: int,
    y: Floats,
    total: float,
    first: int,
    integrating: bool,
    tau: float,
    theta: float,
    a: Floats,
    skip: int,
) -> int:
    """Give lane j a plant, for stems that start at `first`; return the whole samples of its dead time.

    total: the sum of y (`own_sums`).
    """
    plant, rest = plant_terms(integrating, tau, theta), start_rests(a)
    pole, c0, c1, m = plant
    p, whole, delay, lanes = a.size - 1, rest[0], rest[1:].sum(), room.lanes
    lanes[_POLE + j], lanes[_C0 + j], lanes[_C1 + j] = pole, c0, c1
    lanes[_GROWS + j] = whole if integrating else 0.0
    room.after[j] = transient_at(skip, integrating, pole, whole, delay, a)
    # Until the first input has come through the dead time there is no response for a start to go together with.
    room.begins[j] = room.y.size - y.size + first + m + 1
    g = whole * (first + m) - delay if integrating else whole
    for q in range(p + 1):
        room.starts[j, q] = c0 * rest[min(q + 1, p + 1)] + c1 * rest[q]
    room.starts[j, 0] += pole * g
    start_products(y, total, first, integrating, plant, a, rest, skip, np.empty((2, p + 3)), room.products[j])
    return m


@compiled
def _drive_alike(room: _Room, j: int, other: int) -> None:
    """Give lane j the plant of another, for stems that start where that one's do."""
    for at in (_POLE, _C0, _C1, _GROWS):
        room.lanes[at + j] = room.lanes[at + other]
    room.after[j], room.begins[j] = room.after[other], room.begins[other]
    copy(room.starts[other], room.starts[j])
    for i in range(room.products.shape[1]):
        copy(room.products[other, i], room.products[j, i])


@compiled
def _run(room: _Room, a: Floats, skip: int) -> None:
    """Run the lanes over the record; their sums are then in `room.lanes`."""
    lanes, x, w, added, y = room.lanes, room.x, room.w, room.added, room.y
    p, total = a.size - 1, room.y.size
    lead = -skip % STRIDE
    counts = lead + skip
    lanes[_S : _SR + LANES] = 0.0
    x[: p * LANES] = 0.0
    white = p == 0
    late = False
    for chunk in range(0, total, CHUNK):
        rows = min(CHUNK, total - chunk)
        _stems(room.op, chunk, lanes, x, p, rows)
        added[:] = 0.0
        for j in range(LANES):
            for t in range(chunk, min(room.held[j], chunk + rows)):
                # The samples of the record, late by the dead time.
                within = t >= lead + int(room.kept[j, 2])
                x[(p + t - chunk) * LANES + j] = room.bases[j] if within else 0.0
            for q in range(max(chunk - room.begins[j], 0), min(chunk + rows - room.begins[j], p + 1)):
                added[(room.begins[j] + q - chunk) * LANES + j] = room.starts[j, q]
                late = False
        if white:
            w = x
        else:
            _filtered(a, x, w, rows)
        begin = 0
        if chunk <= counts < chunk + rows:
            begin = counts - chunk
            _sums(y, chunk, w, added, lanes, 0, begin, late)
            lanes[_SUM : _SR + LANES] = 0.0
            copy(room.after, lanes[_R : _R + LANES])
            late = False
        _sums(y, chunk, w, added, lanes, begin, rows, late)
        late = True
        for j in range(LANES):
            for at in (_G + j, _R + j):
                if abs(lanes[at]) > GONE:
                    late = False
                else:
                    lanes[at] = 0.0
        for i in range(p * LANES):
            x[i] = x[rows * LANES + i]


@written_out
def _complete(room: _Room, j: int, whole: float, out: Floats) -> None:
    """Write the products of lane j's columns (see `start_products` and `output_error.stem_products`)."""
    lanes = room.lanes
    for i in range(out.shape[0]):
        copy(room.products[j, i], out[i])
    out[0, 1], out[1, 1] = whole * lanes[_SUM + j], lanes[_SS + j]
    out[1, 2], out[1, 3], out[4, 1] = lanes[_SG + j], lanes[_SR + j], lanes[_SY + j]


@compiled
def _take(j: int, lines: Floats, begun: int, of: Ints, at: Floats, end: Floats, pace: Floats) -> int:
    """Give idle lane j the next line, or the further half of that of which the most is left; return those begun.

    pace: each lane's last step, at which it is taken to go on.
    """
    while begun < lines.shape[0]:
        line, begun = lines[begun], begun + 1
        begin = line[BEGIN_J] if line[ALONG] == 1.0 else line[BEGIN_S]
        if begin < line[END]:
            of[j], at[j], end[j], pace[j] = begun - 1, begin, line[END], line[MOST]
            return begun
    most, other = WORTH, -1
    for o in range(LANES):
        if of[o] >= 0 and (end[o] - at[o]) / pace[o] > most:
            most, other = (end[o] - at[o]) / pace[o], o
    if other >= 0:
        of[j], at[j], end[j], pace[j] = of[other], 0.5 * (at[other] + end[other]), end[other], pace[other]
        end[other] = at[j]
    return begun


@compiled
def _band(line: Floats, at: float) -> tuple[float, float]:
    """(S, J) where a line has come to."""
    return (line[BEGIN_S], at) if line[ALONG] == 1.0 else (at, line[BEGIN_J])


@compiled
def _walk(
    room: _Room,
    y: Floats,
    op: Floats,
    lines: Floats,
    sign: float,
    integrating: bool,
    a: Floats,
    skip: int,
    rows: Floats,
) -> int:
    of, at, end, pace = np.full(LANES, -1), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    delays = np.zeros(LANES, np.int64)
    work, out, whole = np.empty((2, 5, 4)), np.empty(FIT), start_rests(a)[0]
    total, power = own_sums(y, skip)
    begun, count, busy = 0, 0, 1
    driven, asked = -1, (0, 0.0, 0.0)  # the lane that was given a plant last, and what for
    if lines.shape[0] > 0 and lines[0, FIRST] >= 0.0:
        # Most lines of a walk start alike: what they share is written at once.
        first, sense = int(lines[0, FIRST]), lines[0, SENSE]
        delay = plant_terms(integrating, lines[0, TAU], lines[0, THETA])[3]
        _lead_in(room, 0, LANES, op, (first, _ramp(op, first, sense), delay))
    while busy > 0 and count < rows.shape[0]:
        busy = 0
        for j in range(LANES):
            while True:
                if of[j] < 0:
                    begun = _take(j, lines, begun, of, at, end, pace)
                    if of[j] < 0:
                        break
                    line = lines[of[j]]
                    first, tau, theta = max(int(line[FIRST]), 0), line[TAU], line[THETA]
                    if driven >= 0 and asked == (first, tau, theta):
                        _drive_alike(room, j, driven)
                        delays[j] = delays[driven]
                    else:
                        delays[j] = _drive(room, j, y, total, first, integrating, tau, theta, a, skip)
                    driven, asked = j, (first, tau, theta)
                line = lines[of[j]]
                start = (int(line[FIRST]), line[SENSE])
                if _enter(room, j, op, _band(line, at[j]), int(line[ALONG]), start, delays[j]):
                    busy += 1
                    break
                # From here on the stem never moves.
                of[j] = -1
        if busy > 0:
            _run(room, a, skip)
        for j in range(LANES):
            if of[j] < 0 or count == rows.shape[0]:
                continue
            line = lines[of[j]]
            _complete(room, j, whole, work[0])
            least(work, power, -math.inf, math.inf, sign, line[TAU], line[THETA], out)
            rows[count, 0], rows[count, 1] = _band(line, at[j])
            rows[count, 2], rows[count, 3], rows[count, 4] = out[SSE], room.lanes[_SLIPS + j], of[j]
            count += 1
            before, at[j] = at[j], max(min(room.lanes[_EDGE + j], at[j] + line[MOST]), at[j] + line[LEAST])
            pace[j] = at[j] - before
            if at[j] >= end[j]:
                of[j] = -1
    return count


def walk_bands(
    y: Floats, op: Floats, lines: Floats, sign: float, integrating: bool, a: Floats, skip: int, most: int
) -> Floats:
    """Walk lines along S or J, and fit the output-error model to each stem met; rows (S, J, COST, SLIPS, line).

    y, a: as in `output_error.oe_cost`. lines: shape (lines, LINE), see BEGIN_S and what follows; a line goes from
    (S, J) on along S or J up to `END`. The slips change where S passes the least return of OP at which the stem turned,
    or J the least advance at which it moved on; between such breakpoints the path shifts evenly. LEAST, MOST: steps in
    %; a least of 0 meets every sequence of slips. most: rows at most. Returned in the order of lines, and along each.
    """
    rows = np.empty((most, ROW))
    count = _walk(_room(y, a, skip), y, op, np.ascontiguousarray(lines), sign, integrating, a, skip, rows)
    rows = rows[:count]
    along = np.where(lines[rows[:, 4].astype(np.int64), ALONG] == 1.0, rows[:, 1], rows[:, 0])
    return rows[np.lexsort((along, rows[:, 4]))]
