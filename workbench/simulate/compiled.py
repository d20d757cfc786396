"""The typed wrappers around numba: `@compiled` and `@written_out` keep a function's type and its `.py_func`."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

__all__ = ["compiled", "written_out"]

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a plain-float function, cached on disk, without fastmath: every rounding stays as written."""
    return cast("Callable[P, R]", numba.njit(cache=True, nogil=True, fastmath=False, error_model="numpy")(function))


def written_out(function: Callable[P, R]) -> Callable[P, R]:
    """The same, written out where it is called, so that constant arguments leave no trace in the compiled code."""
    options = {"cache": True, "nogil": True, "fastmath": False, "error_model": "numpy", "inline": "always"}
    return cast("Callable[P, R]", numba.njit(**options)(function))
