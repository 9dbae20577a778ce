"""Compilation of the loops that NumPy cannot fuse, and the folder that keeps its results.

Numba keys the compiled code of a function by the file that defines it: a changed callee in another file
would be served as it was. Here all kernels are kept in one folder, whose name is a digest over all modules
that hold kernels. Numba fills and reads it.
"""

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numba
import numpy as np

_PACKAGE = Path(__file__).parent
_MARK = b"@compiled"
# Modules without kernels whose constants go into them, as tests/unit/test_kernel_cache.py finds.
_USED_BY_KERNELS = {"compiled.py", "partition.py"}
Kernel = TypeVar("Kernel", bound=Callable[..., Any])

# Of a parallel kernel, only loops over :data:`numba_range` are shared out.
_OTHERS = ("comprehension", "reduction", "inplace_binop", "setitem", "numpy", "stencil", "fusion")
_OWN_LOOPS = dict.fromkeys(_OTHERS, False) | {"prange": True}

KERNELS: list[Any] = []
"""All kernels of the modules that are imported, as Numba's dispatchers."""

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
        # Without a folder to write to, every process compiles. Numba looks where to keep a kernel when it is
        # defined: other people's kernels in this process are kept where they would be without us.
        config: Any = numba.config
        cache_folder, previous_folder = folder(), config.CACHE_DIR
        config.CACHE_DIR = str(cache_folder or "")
        try:
            kernel = numba.njit(error_model="numpy", cache=cache_folder is not None, **options)(function)
        finally:
            config.CACHE_DIR = previous_folder
        KERNELS.append(kernel)
        return cast("Kernel", kernel)

    return compile_


def kernel_sources() -> Iterator[Path]:
    """All modules of the package that hold kernels, or constants of kernels."""
    for path in sorted(_PACKAGE.rglob("*.py")):
        if path.name in _USED_BY_KERNELS or _MARK in path.read_bytes():
            yield path


@cache
def folder() -> Path | None:
    """The folder for compiled kernels, made if need be; None where nothing can be written.

    It is where ``NUMBA_CACHE_DIR`` says, or beside the package, or among the user's caches. When it is made,
    what other versions of the sources have left is removed.
    """
    digest = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for path in kernel_sources():
        digest.update(path.read_bytes())
    # Several machines, and several copies of the package, may share a folder of caches.
    machine = f"{_PACKAGE} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    kind = f"comotion-{hashlib.sha256(machine.encode()).hexdigest()[:8]}-"
    config: Any = numba.config
    parents = [Path(config.CACHE_DIR)] if config.CACHE_DIR else [_PACKAGE / "__pycache__"]
    # A user without an entry in the list of users has no home.
    with suppress(RuntimeError):
        own = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        parents += [] if config.CACHE_DIR else [own]
    for parent in parents:
        made = parent / f"{kind}{digest.hexdigest()[:16]}"
        with suppress(OSError):
            if not made.is_dir():
                made.mkdir(parents=True)
                for other in {*parent.glob(f"{kind}*")} - {made}:
                    shutil.rmtree(other, ignore_errors=True)
            if os.access(made, os.W_OK):
                return made
    return None
