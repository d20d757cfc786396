"""Small problems of the MacMPEC collection (S. Leyffer, Argonne National Laboratory), written from its AMPL statements.

Each has the collection's start (AMPL's 0 where it gives none) and its published optimal value, unless a comment says
what is true instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from workbench.symbolic.mpcc import Mpcc, Pairs
from workbench.symbolic.solve import Group, Nlp

INF = math.inf


@dataclass(frozen=True)
class Published:
    """A problem with its published value, or what is certain about it where that differs."""

    build: Callable[[], Mpcc]
    optimum: float


PROBLEMS: dict[str, Published] = {}


def problem(name: str, optimum: float) -> Callable[[Callable[[], Mpcc]], Callable[[], Mpcc]]:
    def keep(build: Callable[[], Mpcc]) -> Callable[[], Mpcc]:
        PROBLEMS[name] = Published(build, optimum)
        return build

    return keep


def mpcc(x, f, pairs, *, equal=(), least=(), lower=-INF, upper=INF, start=0.0) -> Mpcc:
    """min f, subject to equal = 0, least >= 0, bounds, and 0 <= G perp H >= 0 for each (G, H) of pairs."""
    groups = []
    if equal:
        groups.append(Group("equations", ca.vertcat(*equal)))
    if least:
        groups.append(Group("inequalities", ca.vertcat(*least), 0.0, INF))
    size = int(x.numel())
    nlp = Nlp(
        x=x,
        objective=f,
        groups=tuple(groups),
        lower=np.broadcast_to(np.asarray(lower, float), (size,)),
        upper=np.broadcast_to(np.asarray(upper, float), (size,)),
        start=np.broadcast_to(np.asarray(start, float), (size,)),
    )
    G, H = zip(*pairs, strict=True)
    return Mpcc(nlp, (Pairs("pairs", ca.vertcat(*G), ca.vertcat(*H)),))


@problem("bard1", 17.0)
def bard1() -> Mpcc:
    # J.F. Bard, Convex two-level optimization, Math. Programming 40 (1988) 15-27.
    v = ca.SX.sym("v", 5)
    x, y, a, b, c = ca.vertsplit(v)
    return mpcc(
        v,
        (x - 5) ** 2 + (2 * y + 1) ** 2,
        [(3 * x - y - 3, a), (-x + 0.5 * y + 4, b), (-x - y + 7, c)],
        equal=[2 * (y - 1) - 1.5 * x + a - 0.5 * b + c],
        lower=[0, 0, -INF, -INF, -INF],
    )


@problem("bard3", -12.6787)
def bard3() -> Mpcc:
    v = ca.SX.sym("v", 6)
    x1, x2, y1, y2, l1, l2 = ca.vertsplit(v)
    return mpcc(
        v,
        -(x1**2) - 3 * x2 - 4 * y1 + y2**2,
        [(x1**2 - 2 * x1 + x2**2 - 2 * y1 + y2 + 3, l1), (x2 + 3 * y1 - 4 * y2 - 4, l2)],
        equal=[2 * y1 + 2 * l1 - 3 * l2, -5 - l1 + 4 * l2],
        least=[4 - x1**2 - 2 * x2],
        lower=0.0,
    )


@problem("bilevel1", 0.0)
def bilevel1() -> Mpcc:
    # F. Facchinei, H. Jiang, L. Qi, A smoothing method for MPECs, Math. Program. 85 (1999): problem 7.
    v = ca.SX.sym("v", 10)
    x1, x2, y1, y2, *m = ca.vertsplit(v)
    return mpcc(
        v,
        2 * x1 + 2 * x2 - 3 * y1 - 3 * y2 - 60,
        list(zip([y1 + 10, 20 - y1, y2 + 10, 20 - y2, x1 - 2 * y1 - 10, x2 - 2 * y2 - 10], m, strict=True)),
        equal=[
            2 * y1 - 2 * x1 + 40 - (m[0] - m[1] - 2 * m[4]),
            2 * y2 - 2 * x2 + 40 - (m[2] - m[3] - 2 * m[5]),
        ],
        least=[40 - x1 - x2 - y1 + 2 * y2],
        lower=[0, 0, -INF, -INF] + [0] * 6,
        upper=[50, 50] + [INF] * 8,
    )


@problem("bilevel2", -6600.0)
def bilevel2() -> Mpcc:
    # The same, problem 10.
    v = ca.SX.sym("v", 20)
    parts = ca.vertsplit(v)
    x, y, m = parts[:4], parts[4:8], parts[8:]
    first, second = y[0] + y[2], y[1] + y[3]
    slack = [
        x[0] - 0.4 * y[0] - 0.7 * y[1],
        x[1] - 0.6 * y[0] - 0.3 * y[1],
        y[0],
        20 - y[0],
        y[1],
        20 - y[1],
        x[2] - 0.4 * y[2] - 0.7 * y[3],
        x[3] - 0.6 * y[2] - 0.3 * y[3],
        y[2],
        40 - y[2],
        y[3],
        40 - y[3],
    ]
    return mpcc(
        v,
        -(200 - first) * first - (160 - second) * second,
        list(zip(slack, m, strict=True)),
        equal=[
            y[0] - 4 + 0.4 * m[0] + 0.6 * m[1] - m[2] + m[3],
            y[1] - 13 + 0.7 * m[0] + 0.3 * m[1] - m[4] + m[5],
            y[2] - 35 + 0.4 * m[6] + 0.6 * m[7] - m[8] + m[9],
            y[3] - 2 + 0.7 * m[6] + 0.3 * m[7] - m[10] + m[11],
        ],
        least=[40 - x[0] - x[1] - x[2] - x[3]],
        lower=[0] * 4 + [-INF] * 4 + [0] * 12,
        upper=[10, 5, 15, 20] + [INF] * 16,
        start=[5, 5, 15, 15] + [0] * 16,
    )


@problem("bilevel3", -12.6787)
def bilevel3() -> Mpcc:
    # The same, problem 11.
    v = ca.SX.sym("v", 12)
    parts = ca.vertsplit(v)
    x, y, m = parts[:2], parts[2:8], parts[8:]
    return mpcc(
        v,
        -(x[0] ** 2) - 3 * x[1] - 4 * y[0] + y[1] ** 2,
        list(zip(m, y[2:], strict=True)),
        equal=[
            2 * y[0] + 2 * y[2] - 3 * y[3] - y[4],
            -5 - y[2] + 4 * y[3] - y[5],
            x[0] ** 2 - 2 * x[0] + x[1] ** 2 - 2 * y[0] + y[1] + 3 - m[0],
            x[1] + 3 * y[0] - 4 * y[1] - 4 - m[1],
            y[0] - m[2],
            y[1] - m[3],
        ],
        least=[4 - x[0] ** 2 - 2 * x[1]],
        lower=[0, 0] + [-INF] * 10,
        start=[0, 2] + [0] * 10,
    )


@problem("dempe", 28.25)
def dempe() -> Mpcc:
    # S. Dempe, Optimization 25 (1992) 341-354. The value is an infimum: z -> 0 with the multiplier w -> infinity.
    v = ca.SX.sym("v", 3)
    x, z, w = ca.vertsplit(v)
    return mpcc(
        v,
        (x - 3.5) ** 2 + (z + 4) ** 2,
        [(x - z**2, w)],
        equal=[z - 3 + 2 * z * w],
        lower=[-INF, -INF, 0],
        start=[0.183193, 0.428106, 3.00379],
    )


@problem("desilva", -1.0)
def desilva() -> Mpcc:
    # Facchinei, Jiang and Qi, problem 5.
    v = ca.SX.sym("v", 6)
    x1, x2, y1, y2, l1, l2 = ca.vertsplit(v)
    return mpcc(
        v,
        x1**2 - 2 * x1 + x2**2 - 2 * x2 + y1**2 + y2**2,
        [(0.25 - (y1 - 1) ** 2, l1), (0.25 - (y2 - 1) ** 2, l2)],
        equal=[2 * y1 - 2 * x1 + 2 * (y1 - 1) * l1, 2 * y2 - 2 * x2 + 2 * (y2 - 1) * l2],
        lower=[0, 0, -INF, -INF, 0, 0],
        upper=[2, 2] + [INF] * 4,
    )


@problem("df1", 0.0)
def df1() -> Mpcc:
    # S.P. Dirkse, M.C. Ferris, Modeling and solution environments for MPEC, 1997.
    v = ca.SX.sym("v", 2)
    x, y = ca.vertsplit(v)
    return mpcc(
        v,
        (x - 1 - y) ** 2,
        [(y - x**2 + 1, y)],
        least=[2 - x**2, 3 - (x - 1) ** 2 - (y - 1) ** 2],
        lower=[-1, 0],
        upper=[2, INF],
    )


def floudas(f, x, s, m, equal, free=(), upper=None) -> Mpcc:
    """A problem of C.A. Floudas et al., Handbook of Test Problems, chapter 9: slacks s against multipliers m."""
    v = ca.vertcat(*x, *s, *m)
    size = int(v.numel())
    lower = np.zeros(size)
    lower[list(free)] = -INF
    top = np.full(size, INF)
    for k, value in (upper or {}).items():
        top[k] = value
    return mpcc(v, f, list(zip(m, s, strict=True)), equal=equal, lower=lower, upper=top)


def symbols(names: str) -> list[ca.SX]:
    return [ca.SX.sym(name) for name in names.split()]


@problem("ex9.1.4", -37.0)
def ex9_1_4() -> Mpcc:
    x, y, *rest = symbols("x y s1 s2 s3 s4 l1 l2 l3 l4")
    s, m = rest[:4], rest[4:]
    equal = [
        -2 * x + y + s[0],
        2 * x + 5 * y + s[1] - 108,
        2 * x - 3 * y + s[2] + 4,
        -y + s[3],
        m[0] + 5 * m[1] - 3 * m[2] - m[3] + 1,
    ]
    return floudas(x - 4 * y, [x, y], s, m, equal)


@problem("ex9.2.2", 100.0)
def ex9_2_2() -> Mpcc:
    x, y, *rest = symbols("x y s1 s2 s3 s4 l1 l2 l3 l4")
    s, m = rest[:4], rest[4:]
    v = ca.vertcat(x, y, *s, *m)
    return mpcc(
        v,
        x**2 + (y - 10) ** 2,
        list(zip(m, s, strict=True)),
        equal=[x + y + s[0] - 20, -y + s[1], y + s[2] - 20, 2 * (x + 2 * y - 30) + m[0] - m[1] + m[2]],
        least=[x - y],
        lower=0.0,
        upper=[15] + [INF] * 9,
    )


@problem("ex9.2.4", 0.5)
def ex9_2_4() -> Mpcc:
    l0, x, y1, y2, s1, s2, l1, l2 = symbols("l0 x y1 y2 s1 s2 l1 l2")
    equal = [y1 + y2 - x, -y1 + s1, -y2 + s2, y1 + l0 - l1, 1 + l0 - l2]
    return floudas(0.5 * (y1 - 2) ** 2 + 0.5 * (y2 - 2) ** 2, [l0, x, y1, y2], [s1, s2], [l1, l2], equal, free=[0])


@problem("ex9.2.5", 5.0)
def ex9_2_5() -> Mpcc:
    # The collection's table prints 6.0; the statement's own optimum is 5.0, at (x, y) = (1, 3).
    y, x, *rest = symbols("y x s1 s2 s3 l1 l2 l3")
    s, m = rest[:3], rest[3:]
    equal = [
        -2 * x + y + s[0] - 1,
        x - 2 * y + s[1] - 2,
        x + 2 * y + s[2] - 14,
        2 * (y - 5) + m[0] - 2 * m[1] + 2 * m[2],
    ]
    return floudas((x - 3) ** 2 + (y - 2) ** 2, [y, x], s, m, equal, free=[0], upper={1: 8})


@problem("ex9.2.7", 17.0)
def ex9_2_7() -> Mpcc:
    x, y, *rest = symbols("x y s1 s2 s3 s4 l1 l2 l3 l4")
    s, m = rest[:4], rest[4:]
    equal = [
        -3 * x + y + s[0] + 3,
        x - 0.5 * y + s[1] - 4,
        x + y + s[2] - 7,
        -y + s[3],
        2 * (y - 1) - 1.5 * x + m[0] - 0.5 * m[1] + m[2] - m[3],
    ]
    return floudas((x - 5) ** 2 + (2 * y + 1) ** 2, [x, y], s, m, equal)


@problem("ex9.2.8", 1.5)
def ex9_2_8() -> Mpcc:
    x, y, s1, s2, l1, l2 = symbols("x y s1 s2 l1 l2")
    equal = [-y + s1, y + s2 - 1, -(1 - 4 * x) - l1 + l2]
    return floudas(-4 * x * y + 3 * y + 2 * x + 1, [x, y], [s1, s2], [l1, l2], equal, upper={0: 1})


@problem("ex9.2.9", 2.0)
def ex9_2_9() -> Mpcc:
    x, y1, y2, *rest = symbols("x y1 y2 s1 s2 s3 l1 l2 l3")
    s, m = rest[:3], rest[3:]
    v = ca.vertcat(x, y1, y2, *rest)
    return mpcc(
        v,
        x + y2,
        list(zip(m, s, strict=True)),
        equal=[x - y1 - y2 + s[0] + 4, -y1 + s[1], -y2 + s[2], 2 - m[0] - m[1], x - m[0] - m[2]],
        lower=[2] + [0] * 8,
        upper=[4] + [INF] * 8,
    )


@problem("gauvin", 20.0)
def gauvin() -> Mpcc:
    # J. Gauvin, G. Savard, Working Paper G9037, GERAD, Montreal, 1992.
    v = ca.SX.sym("v", 3)
    x, y, u = ca.vertsplit(v)
    return mpcc(
        v,
        x**2 + (y - 10) ** 2,
        [(4 * (x + 2 * y - 30) + u, y), (20 - x - y, u)],
        lower=0.0,
        upper=[15, INF, INF],
        start=[7.5, 0, 1],
    )


A, B = ca.SX.sym("a"), ca.SX.sym("b")


def plane(f, G, H, *, lower=-INF, start=0.0) -> Mpcc:
    """Two variables, A and B, and one pair."""
    return mpcc(ca.vertcat(A, B), f, [(G, H)], lower=lower, start=start)


@problem("jr1", 0.5)
def jr1() -> Mpcc:
    return plane((A - 1) ** 2 + B**2, B - A, B, lower=[-INF, 0])


@problem("jr2", 0.5)
def jr2() -> Mpcc:
    return plane((B - 1) ** 2 + A**2, B - A, B, lower=[-INF, 0])


@problem("kth1", 0.0)
def kth1() -> Mpcc:
    return plane(A + B, A, B, lower=0.0, start=[0, 1])


@problem("kth2", 0.0)
def kth2() -> Mpcc:
    return plane(A + (B - 1) ** 2, A, B, lower=0.0, start=[1, 0])


@problem("kth3", 0.5)
def kth3() -> Mpcc:
    return plane(0.5 * (A - 1) ** 2 + (B - 1) ** 2, A, B, lower=0.0, start=1.0)


def outrata(extra) -> Mpcc:
    """J. Outrata, SIAM J. Optim. 4 (1994) 340-357; S. Scholtes, Research Papers in Management Studies 26/1997.

    extra: what the variant adds to the sum of squares, of the last two states.
    """
    v = ca.SX.sym("v", 5)
    a, b, c, d, y = ca.vertsplit(v)
    pairs = [
        ((1 + 0.2 * y) * a - (3 + 1.333 * y) - 0.333 * c + 2 * a * d, a),
        ((1 + 0.1 * y) * b - y + c + 2 * b * d, b),
        (0.333 * a - b + 1 - 0.1 * y, c),
        (9 + 0.1 * y - a**2 - b**2, d),
    ]
    f = ((a - 3) ** 2 + (b - 4) ** 2 + extra(ca.vertcat(c, d))) / 2
    return mpcc(v, f, pairs, lower=0.0, upper=[INF] * 4 + [10])


@problem("outrata31", 3.2077)
def outrata31() -> Mpcc:
    return outrata(lambda last: 0.0 * last[0])


@problem("outrata32", 3.4494)
def outrata32() -> Mpcc:
    return outrata(lambda last: (last[0] - 1) ** 2)


@problem("outrata33", 4.60425)
def outrata33() -> Mpcc:
    return outrata(lambda last: 10 * last[1] ** 2)


@problem("ralph1", 0.0)
def ralph1() -> Mpcc:
    # D. Ralph. Its solution is B-stationary but not strongly stationary.
    return plane(2 * A - B, B, B - A, lower=0.0)


@problem("ralph2", 0.0)
def ralph2() -> Mpcc:
    return plane(A**2 + B**2 - 4 * A * B, A, B, lower=[0, -INF], start=1.0)


@problem("scale1", 1.0)
def scale1() -> Mpcc:
    return plane((100 * A - 1) ** 2 + (B - 1) ** 2, A, B)


@problem("scale4", 1.0)
def scale4() -> Mpcc:
    return plane((100 * A - 1) ** 2 + (100 * B - 1) ** 2, A, B)


@problem("scale5", 100.0)
def scale5() -> Mpcc:
    return plane(100 * (A - 1) ** 2 + 100 * (B - 1) ** 2, A, B)


def scholtes(f) -> Mpcc:
    """S. Scholtes, Research Papers in Management Studies 26/1997."""
    v = ca.SX.sym("v", 3)
    x, y1, y2 = ca.vertsplit(v)
    return mpcc(v, f(x, y1, y2), [(-ca.exp(x) + y1 - ca.exp(y2), x)], lower=[0, -INF, 0], start=1.0)


@problem("scholtes1", 2.0)
def scholtes1() -> Mpcc:
    return scholtes(lambda x, y1, y2: (x + 1) ** 2 + (y1 - 2.5) ** 2 + (y2 + 1) ** 2)


@problem("scholtes2", 15.0)
def scholtes2() -> Mpcc:
    return scholtes(lambda x, y1, y2: (x + 1) ** 2 + y1**2 + 10 * (y2 + 1) ** 2)


@problem("scholtes3", 0.5)
def scholtes3() -> Mpcc:
    return plane(0.5 * ((A - 1) ** 2 + (B - 1) ** 2), A, B, lower=0.0, start=1e-4)


@problem("scholtes4", 0.0)
def scholtes4() -> Mpcc:
    # The collection prints -3.07336e-7, a relaxed solver's; z1 z2 = 0 with z3 <= 4 z1, 4 z2 gives z1 + z2 - z3 >= 0.
    v = ca.SX.sym("v", 3)
    a, b, c = ca.vertsplit(v)
    return mpcc(v, a + b - c, [(a, b)], least=[4 * a - c, 4 * b - c], lower=[0, 0, -INF], start=[0, 1, 0])


@problem("scholtes5", 1.0)
def scholtes5() -> Mpcc:
    # S. Scholtes, SIAM J. Optim. 11 (2001) 918-936.
    v = ca.SX.sym("v", 3)
    a, b, c = ca.vertsplit(v)
    return mpcc(v, (a - 1) ** 2 + (b - 2) ** 2 + (c + 1) ** 2, [(a, c), (b, c)], lower=0.0, start=1.0)


@problem("sl1", 1e-4)
def sl1() -> Mpcc:
    # From an idea of S. Scholtes, with the constraints of problem HS21.
    v = ca.SX.sym("v", 8)
    x1, x2, z1, z2, z3, l1, l2, l3 = ca.vertsplit(v)
    return mpcc(
        v,
        (x1 - 2) ** 2 + x2**2,
        [(10 * x1 + x2 - 10 - z1, l1), (x1 - 2 - z2, l2), (x2 - 50 * z3, l3)],
        equal=[0.02 * x1 - 10 * l1 - l2, 2 * x2 - l1 - l3],
        lower=[-INF, -INF, 10, 0.01, 0, 0, 0, 0],
        upper=[INF, INF, 1e10, 10, 1, INF, INF, INF],
    )


@problem("stackelberg1", -3266.67)
def stackelberg1() -> Mpcc:
    # Facchinei, Jiang and Qi, problem 6; exactly -9800/3.
    v = ca.SX.sym("v", 3)
    x, y, m = ca.vertsplit(v)
    return mpcc(
        v,
        0.5 * x**2 + 0.5 * x * y - 95 * x,
        [(y, m)],
        equal=[2 * y + 0.5 * x - 100 - m],
        lower=0.0,
        upper=[200, INF, INF],
    )
