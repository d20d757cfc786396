"""The typed wrappers around numba: `@compiled` and its kin keep a function's type and its `.py_func`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["compiled", "copy", "specialised", "written_out"]

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a plain-float function, cached on disk, without fastmath: every rounding stays as written.

    A constant that compiled code calls it with is a value there like any other. numba would take each for a type of its
    own, and compile the function and all that it calls once more: `specialised` and `written_out` are where that pays.
    """
    made = _made(function)
    if not numba.config.DISABLE_JIT:
        called_with, value = made.get_call_template, numba.types.unliteral

        def called_with_values(args: Any, kws: Any) -> Any:
            return called_with(tuple(map(value, args)), {name: value(kind) for name, kind in kws.items()})

        made.get_call_template = called_with_values
    return cast("Callable[P, R]", made)


def specialised(function: Callable[P, R]) -> Callable[P, R]:
    """The same, compiled once more for each constant that compiled code calls it with: a valve's kind, in a loop."""
    return cast("Callable[P, R]", _made(function))


def written_out(function: Callable[P, R]) -> Callable[P, R]:
    """The same, written out where it is called, so that constant arguments leave no trace in the compiled code."""
    return cast("Callable[P, R]", _made(function, inline="always"))


def _made(function: Callable[..., Any], **more: str) -> Any:
    options = {"cache": True, "nogil": True, "fastmath": False, "error_model": "numpy"}
    # Nobody calls these functions as C: numba would write, and compile, one more entry for each.
    made = numba.njit(no_cfunc_wrapper=True, **options, **more)(function)
    if not numba.config.DISABLE_JIT:
        # numba's cache holds for a file as it was, but what is compiled holds functions and constants of others too.
        file = made._cache._cache_file
        file._source_stamp = (file._source_stamp, _stamp(function))
    return made


def _stamp(function: Callable[..., Any]) -> str:
    """What the files are now that a function's compiled code may come from, as one word.

    They are its own, and those of all compiled functions that its file imports, and that theirs do.
    """
    files = {__file__, function.__code__.co_filename}
    waiting = [function.__globals__]
    while waiting:
        for value in waiting.pop().values():
            inner = getattr(value, "py_func", None)
            if inner is not None and inner.__code__.co_filename not in files:
                files.add(inner.__code__.co_filename)
                waiting.append(inner.__globals__)
    paths = [Path(name) for name in sorted(files)]
    return "".join(_digest(path, path.stat().st_mtime_ns, path.stat().st_size) for path in paths if path.exists())


@cache
def _digest(path: Path, changed: int, size: int) -> str:  # noqa: ARG001 a file that has changed is read anew
    return hashlib.sha256(path.read_bytes()).hexdigest()


@compiled
def copy(source: NDArray[np.float64], target: NDArray[np.float64]) -> None:
    """`target[:] = source`, which would bring in all that numba knows of shapes, and seconds of compilation."""
    for i in range(target.size):
        target[i] = source[i]
