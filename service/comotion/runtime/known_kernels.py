"""Remembers what a complete warm-up has compiled, so that a later process loads it from the disk.

Loading takes a fraction of the time that it takes to run what would load it.
"""

import json
import os
import sys
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from comotion_schemas.errors import KnownError

from ..kernel_cache import KernelCache, source_digest
from .state_file import write_atomically


def kernels() -> dict[str, Dispatcher]:
    """Every kernel of the core that this process has imported, by name."""
    modules = [module for name, module in sys.modules.items() if name.startswith("comotion.")]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher))
    return {f"{one.py_func.__module__}.{one.py_func.__qualname__}": one for one in found}


def load(method: str) -> bool:
    """Load all that a warm-up of this version has needed for a method.

    Returns
    -------
    bool
        Whether it is all there; False: nothing is known, or something would have to be compiled.
    """
    known = kernels()
    try:
        wanted = json.loads(_file(method, known).read_text())
        return all(_load(known[name], signatures) for name, signatures in wanted.items())
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        return False


def can_be_kept(method: str) -> bool:
    """Whether there is a folder for what a warm-up compiles."""
    with suppress(OSError, ValueError):
        return os.access(_file(method, kernels()).parent, os.W_OK)
    return False


def note(method: str) -> None:
    """Keep what this process has loaded and compiled as what a warm-up needs for a method."""
    known = kernels()
    wanted = {name: sorted(map(str, one.signatures)) for name, one in known.items() if one.signatures}
    # Without a folder to write to, every process compiles.
    with suppress(OSError, ValueError):
        file = _file(method, known)
        write_atomically(file, [json.dumps(wanted).encode()])
        for other in file.parent.glob(f"{method}-*.json"):
            if other != file:
                other.unlink(missing_ok=True)


def _file(method: str, known: dict[str, Dispatcher]) -> Path:
    """Beside the compiled kernels."""
    for _, one in sorted(known.items()):
        kept = getattr(one, "_cache", None)
        if isinstance(kept, KernelCache):
            return Path(kept.cache_path) / f"{method}-{source_digest()}-{_warm_up_digest():08x}.json"
    raise KnownError("no kernel is kept on disk")


@cache
def _warm_up_digest() -> int:
    """Which kernels are needed depends on what a warm-up does."""
    return zlib.crc32(Path(__file__).with_name("warm_up.py").read_bytes())


def _load(kernel: Dispatcher, wanted: list[str]) -> bool:
    """Load some signatures of a kernel; False if one is not on the disk for this processor."""
    kept = kernel._cache  # type: ignore[attr-defined]
    there = {str(found): found for found in kept.signatures(kernel.targetctx)}
    if not there.keys() >= set(wanted):
        return False
    for one in wanted:
        kernel.compile(there[one])
    return True
