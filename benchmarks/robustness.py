"""Estimation and detection of whatever a loop may record: does any record end in a traceback, or never end?

Random loops of `detection.py`, `load_steps.py` and `estimation.py`, as they are, cut to a stretch, or changed as
`detection.py` changes records; with DIR, real records (`DIR/*/*.csv`) changed likewise. Each is looked at by
`detect`, then estimated with a random valve, plant, longest dead time and method; an error of our own is an answer.

Printed: each record that ends otherwise, or takes longer than LONG, and in the end how many there were of each answer
and the longest times. A record is repeated by its number: `--only NUMBER`.

Run: python benchmarks/robustness.py [--seconds 300] [--first 0] [--only NUMBER] [--records DIR]
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from detection import SEEDED, changed, random_record
from estimation import case
from load_steps import MOST, healthy

import workbench as wb

LONG, ENDLESS = 30.0, 120  # s of processor time that are told, and by the clock that no record may take
VALVES = ("auto", "auto", "auto", "stenman", "choudhury", "deadband", "linear")
METHODS = ("profile",) * 14 + ("two_step",) * 3 + ("joint",) * 2 + ("complementarity",)
KINDS, PLANTS = ("stenman", "choudhury", "deadband"), ("fopdt", "integrating")


def simulated(rng: np.random.Generator) -> wb.Record:
    """A random loop's record."""
    plant, source = str(rng.choice(PLANTS)), int(rng.integers(3))
    if source == 0:
        return random_record(str(rng.choice(SEEDED)), plant == "integrating", int(rng.integers(2**31)))[0]
    if source == 1:
        return healthy(rng, plant, int(rng.integers(MOST + 1)))[2]
    while (one := case(rng, str(rng.choice(KINDS)), plant)) is None:
        pass
    return one.record


def altered(rng: np.random.Generator, record: wb.Record) -> wb.Record:
    """The record as it is, a stretch of it, or as something else keeps it."""
    how, n = int(rng.integers(4)), len(record)
    if how == 0:
        return record
    if how == 1:
        begin = int(rng.integers(0, n // 2))
        at = slice(begin, begin + int(rng.integers(3, n // 2)))
        sp = None if record.sp is None or rng.random() < 0.5 else record.sp[at]
        return wb.Record(record.pv[at], record.op[at], record.sample_time * 10.0 ** int(rng.integers(-2, 3)), sp=sp)
    ways = list(changed(record))
    return ways[int(rng.integers(len(ways)))][1]


def asked(rng: np.random.Generator, record: wb.Record) -> dict[str, object]:
    """Random arguments of `wb.estimate`."""
    options: dict[str, object] = {"method": str(rng.choice(METHODS)), "valve": str(rng.choice(VALVES))}
    if options["method"] in ("two_step", "complementarity"):
        options["valve"] = "stenman"
    if rng.random() < 0.4:
        options["plant"] = str(rng.choice(PLANTS))
    if rng.random() < 0.3:
        options["max_dead_time"] = float(rng.choice([0.0, 1.0, 5.0, 40.0, 300.0])) * record.sample_time
    return options


class Endless(Exception):
    """A record took too long."""


def ended(record: wb.Record, options: dict[str, object]) -> str:
    """What an estimate comes to in a word."""

    def stop(*_: object) -> None:
        raise Endless

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(ENDLESS)
    try:
        wb.detect(record, bicoherence=True)
        return wb.estimate(record, **options).verdict
    except wb.WorkbenchError:
        return "refused"
    except Endless:
        return "endless"
    except Exception as error:  # noqa: BLE001 what this is here to find
        return f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)


def main() -> int:
    """Print what records end in; return 1 where one ends in a traceback, or not at all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--records", type=Path)
    args = parser.parse_args()
    files = [] if args.records is None else sorted(args.records.glob("*/*.csv"))
    real = [wb.read_record(file) for file in files if file.name != "labels.csv"]
    answers: Counter[str] = Counter()
    longest: list[tuple[float, int]] = []
    begun, number = time.monotonic(), args.first if args.only is None else args.only
    while time.monotonic() - begun < args.seconds:
        rng = np.random.default_rng([77, number])
        record = altered(rng, real[int(rng.integers(len(real)))] if real else simulated(rng))
        options = asked(rng, record)
        took = time.process_time()
        answer = ended(record, options)
        took = time.process_time() - took
        known = answer in ("stiction", "no_stiction", "undecided", "refused")
        answers[answer if known else "other"] += 1
        longest = sorted([*longest, (took, number)], reverse=True)[:5]
        if not known or took > LONG or args.only is not None:
            print(f"{number}: {answer}, {len(record)} samples, {options}, {took:.1f} s", flush=True)
        if args.only is not None:
            return int(not known)
        number += 1
    print(f"records {args.first} to {number - 1}: {dict(answers)}")
    print("longest:", ", ".join(f"{took:.1f} s ({which})" for took, which in longest))
    return int(answers["other"] > 0)


if __name__ == "__main__":
    sys.exit(main())
