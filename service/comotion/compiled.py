"""Compilation of the loops that NumPy cannot fuse."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

import numba

from .kernel_cache import KernelCache

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

# Some ten microseconds; a second thread is at work after three.
_WORTH_WAKING = 30_000
# Of what a kernel does, only the loops that ask for it are shared out.
_OWN_LOOPS = {
    "comprehension": False,
    "reduction": False,
    "inplace_binop": False,
    "setitem": False,
    "numpy": False,
    "stencil": False,
    "fusion": False,
    "prange": True,
}

numba_range = numba.prange
"""A range whose turns are shared out among the cores, in kernels compiled with ``parallel=True``."""


def compiled(*, parallel: bool = False, **options: Any) -> Callable[[Kernel], Kernel]:
    """Compile a function of arrays to machine code, kept on disk where that is possible.

    `options` are Numba's. Of ``fastmath`` only ``{"contract"}`` is allowed, where products and sums stand in
    one function. The other flags let the compiler order sums by what it sees around them, which differs
    between the process that compiles and those that load: updates would differ in their last bits.
    """
    if parallel:
        options["parallel"] = _OWN_LOOPS

    def compile_(function: Kernel) -> Kernel:
        kernel = numba.njit(error_model="numpy", **options)(function)
        # Without a folder to write to, every process compiles.
        with suppress(RuntimeError):
            kernel._cache = KernelCache(function)  # type: ignore[no-untyped-call]
        return cast("Kernel", kernel)

    return compile_


def worth_waking(operations: int) -> bool:
    """Whether so many operations take longer than waking the other threads."""
    return operations > _WORTH_WAKING
