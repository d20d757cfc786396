"""The typed wrappers around numba: `@compiled` and its kin keep a function's type and its `.py_func`."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["compiled", "copy", "fused", "place", "specialised", "written_out"]

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
IMPORT = re.compile(r"^from (\S+) import (\([^)]*\)|.*)", re.MULTILINE)
# A place in an array, which does not count from its end: what is added to one must be one too. With it a loop over
# samples calls compiled functions for a few of them each: a slice handed on instead costs some 20 ns, as references to
# it are counted, and an index that may be negative is looked at for each lane.
place = np.uintp
CONSTANT = (int, float, tuple, np.generic, np.ndarray)  # what compiled code holds as it was then


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a plain-float function, cached on disk, without fastmath: every rounding stays as written.

    A constant that compiled code calls it with is a value there like any other. numba would take each for a type of its
    own, and compile the function and all that it calls once more: `specialised` and `written_out` are where that pays.
    """
    return cast("Callable[P, R]", _plain(_made(function)))


def fused(function: Callable[P, R]) -> Callable[P, R]:
    """The same, but that a product may be added unrounded (fused multiply-add): sums of products, as of least squares.

    Not for what is compared exactly, such as a stem's path: the last digits are then the processor's.
    """
    return cast("Callable[P, R]", _plain(_made(function, fastmath={"contract"})))


def specialised(function: Callable[P, R]) -> Callable[P, R]:
    """The same, compiled once more for each constant that compiled code calls it with: a valve's kind, in a loop."""
    return cast("Callable[P, R]", _made(function))


def written_out(function: Callable[P, R]) -> Callable[P, R]:
    """The same, written out where it is called, so that constant arguments leave no trace in the compiled code."""
    return cast("Callable[P, R]", _made(function, inline="always"))


def _plain(made: Any) -> Any:
    """A compiled function for which constants are values like any other."""
    if not numba.config.DISABLE_JIT:
        called_with, value = made.get_call_template, numba.types.unliteral

        def called_with_values(args: Any, kws: Any) -> Any:
            return called_with(tuple(map(value, args)), {name: value(kind) for name, kind in kws.items()})

        made.get_call_template = called_with_values
    return made


def _made(function: Callable[..., Any], **more: Any) -> Any:
    options = {"cache": True, "nogil": True, "fastmath": False, "error_model": "numpy", **more}
    # Nobody calls these functions as C: numba would write, and compile, one more entry for each.
    made = numba.njit(no_cfunc_wrapper=True, **options)(function)
    if not numba.config.DISABLE_JIT:
        # numba's cache holds for a file as it was, but what is compiled holds functions and constants of others too.
        file = made._cache._cache_file
        file._source_stamp = (file._source_stamp, _stamp(function))
    return made


def _stamp(function: Callable[..., Any]) -> str:
    """What the files are now that a function's compiled code may come from, as one word.

    They are its own, and those from which its file imports compiled functions or constants, and so on from them.
    """
    files, waiting = {Path(__file__)}, {Path(function.__code__.co_filename)}
    while waiting:
        files |= waiting
        waiting = {source for file in waiting for source in _at(file, _sources)} - files
    return "".join(_at(file, _digest) for file in sorted(files))


def _at(file: Path, read: Callable[[Path, int, int], T]) -> T:
    """What `read` makes of a file, anew where it has changed."""
    status = file.stat()
    return read(file, status.st_mtime_ns, status.st_size)


@cache
def _sources(file: Path, changed: int, size: int) -> list[Path]:  # noqa: ARG001 see `_at`
    found = []
    for name, names in IMPORT.findall(file.read_text(encoding="utf-8")):
        module = sys.modules.get(name)
        values = [getattr(module, word, None) for word in re.findall(r"\w+", names)]
        if any(isinstance(v, CONSTANT) or hasattr(v, "py_func") for v in values) and module and module.__file__:
            found.append(Path(module.__file__))
    return found


@cache
def _digest(file: Path, changed: int, size: int) -> str:  # noqa: ARG001 see `_at`
    return hashlib.sha256(file.read_bytes()).hexdigest()


@compiled
def copy(source: NDArray[np.float64], target: NDArray[np.float64]) -> None:
    """`target[:] = source`, which would bring in all that numba knows of shapes, and seconds of compilation."""
    for i in range(target.size):
        target[i] = source[i]
