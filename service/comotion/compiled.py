"""Compilation of the loops that NumPy cannot fuse."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[Kernel], Kernel]:
    """Compile a function of arrays to machine code, kept on disk where that is possible."""

    def compile_(function: Kernel) -> Kernel:
        try:
            kernel: Kernel = numba.njit(cache=True, error_model="numpy", **options)(function)
        except RuntimeError:
            # Neither the package nor the user's cache can be written to: compile in every process.
            kernel = numba.njit(error_model="numpy", **options)(function)
        return kernel

    return compile_
