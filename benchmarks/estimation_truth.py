"""Which wrong estimates are failures of the search, and which the record itself does not tell from the truth.

Random loops of `estimation.py` with noise of 1 to 5 % of PV's swing and four slips or more, the kind of plant named.
What the true model leaves of PV is the noise that was drawn, known sample by sample. A found model that leaves more, by
10 of `N log V` ("very strong" evidence), missed a likelier one: the search failed, or a start that a fit leaves out is
felt beyond it. One that leaves no more is as likely as the truth, however far off its parameters are. The first
twentieth of a record, which may answer to slips before it, does not count.

Printed for each class: how many have stick band and gain within 5 %; of the others in how many the truth is likelier,
and in how many not, and how many of them are called identified; in how many the truth is likelier though both are
within 5 %. Two lines for each that the truth is ahead of.

Run: python benchmarks/estimation_truth.py [LOOPS [SEED]]
"""

from __future__ import annotations

import math
import sys

import numpy as np
from estimation import CLOSE, Case, errors, random_cases

import workbench as wb

LIKELIER = 10.0  # of N log V
SLIPS, QUIET, LOUD = 4, 0.0, 0.05  # least slips; noise, of PV's swing, beyond and up to which it counts


def wanted(c: Case) -> bool:
    """Whether a case has noise that tells, and enough slips to say anything."""
    return QUIET < c.noise <= LOUD and c.slips >= SLIPS


def ahead(c: Case, found: wb.Estimate) -> float:
    """By how much of `N log V` the true model is ahead of what was found."""
    noise, pv = c.experiment.noise, c.record.pv
    drawn = np.random.default_rng(noise.seed).normal(0.0, noise.sd, c.skip + len(pv) + 1)[c.skip : -1]
    clean = wb.simulate(c.loop, c.experiment).pv[c.skip :] - drawn + 50.0
    first = len(pv) // 20
    left = [float(((pv - one)[first:] ** 2).sum()) for one in (found.prediction, clean)]
    return (len(pv) - first) * math.log(left[0] / left[1])


def main(loops: int, seed: int) -> None:
    """Print the table."""
    for kind, plant, cases in random_cases(loops, seed, wanted):
        for load in (False, True):
            rows = []
            for c in cases:
                if (c.experiment.load is not None) == load:
                    found = wb.estimate(c.record, plant=plant)
                    off = errors(c, found)
                    right = all(abs(off[name]) <= CLOSE[name] for name in ("S", "K"))
                    behind = ahead(c, found)
                    rows.append((right, behind > LIKELIER, found.identifiable))
                    if behind > LIKELIER:
                        steps = [f"{step.size:.3g} at {step.at:.4g} s" for step in found.load_steps]
                        print(f"  {behind:.0f} behind: {c.loop.valve}, {c.loop.plant}, load {c.experiment.load}, from")
                        print(f"    {c.skip} s on; found {found.valve}, {found.plant}, load {', '.join(steps) or None}")
            wrong = [row for row in rows if not row[0]]
            print(
                f"{kind}, {plant}, {'with a load step' if load else 'without load'}: {len(rows) - len(wrong)} of "
                f"{len(rows)} within 5 %; of the others the truth is likelier in {sum(row[1] for row in wrong)}, no "
                f"likelier in {sum(not row[1] for row in wrong)}, called identified {sum(row[2] for row in wrong)}; "
                f"within 5 % yet the truth likelier in {sum(right and more for right, more, _ in rows)}",
                flush=True,
            )


if __name__ == "__main__":
    main(*(int(word) for word in (sys.argv[1:] + ["24", "0"][len(sys.argv) - 1 :])))
