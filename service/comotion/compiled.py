"""Compilation of the loops that NumPy cannot fuse."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

# A few tenths of a millisecond.
_WORTH_WAKING = 300_000

numba_range = numba.prange
"""A range whose turns are shared out among the cores, in kernels compiled with ``parallel=True``."""


def compiled(**options: Any) -> Callable[[Kernel], Kernel]:
    """Compile a function of arrays to machine code, kept on disk where that is possible.

    `options` are Numba's. With ``fastmath`` the order of a sum follows from what the compiler sees around
    it, and that differs between the process that compiles and those that load: use it where no update
    hangs on the last bit.
    """

    def compile_(function: Kernel) -> Kernel:
        try:
            kernel: Kernel = numba.njit(cache=True, error_model="numpy", **options)(function)
        except RuntimeError:
            # Neither the package nor the user's cache can be written to: compile in every process.
            kernel = numba.njit(error_model="numpy", **options)(function)
        return kernel

    return compile_


class threads_for:  # noqa: N801
    """Context in which one thread alone does what takes less time than waking the others."""

    def __init__(self, operations: int) -> None:
        self._alone = operations <= _WORTH_WAKING

    def __enter__(self) -> None:
        self._before = numba.get_num_threads()
        if self._alone:
            numba.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        numba.set_num_threads(self._before)
