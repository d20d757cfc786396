"""One thread for linear algebra: what is solved here is small, and threads of it wait for each other."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]

P = ParamSpec("P")
R = TypeVar("R")


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let linear algebra run in one thread while a function runs, and as it was set before once it has ended.

    OpenBLAS's threads wait for each other by spinning. On a processor that other work keeps busy, a second estimate
    say, each product of matrices, 60 us alone, then waits for the scheduler, tens of milliseconds.
    """

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with _pools().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return alone


@cache
def _pools() -> ThreadpoolController:
    # numpy's and scipy's libraries are two; numba's products are of scipy's, which it loads when they are first used.
    import scipy.linalg.cython_blas  # noqa: F401

    return ThreadpoolController()
