"""What a complete warm-up has compiled in; the same loaded from the disk by a later process out.

Loading takes a fraction of the time that it takes to run what would load it.
"""

import pickle
import sys
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from comotion_schemas.errors import KnownError

from ..kernel_cache import folder
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
        Whether it was known what that is. What has gone from the disk since is compiled.
    """
    known = kernels()
    try:
        # As trustworthy as the machine code beside it, which Numba keeps as pickles too.
        wanted = pickle.loads(_file(method).read_bytes())  # noqa: S301
        for name, signatures in wanted.items():
            for signature in signatures:
                known[name].compile(signature)
    # A damaged pickle may raise anything.
    except Exception:
        return False
    return True


def can_be_kept() -> bool:
    """Whether there is a folder for what a warm-up compiles."""
    return folder() is not None


def note(method: str) -> None:
    """Keep what this process has loaded and compiled as what a warm-up needs for a method."""
    wanted = {name: one.signatures for name, one in kernels().items() if one.signatures}
    # Without a folder to write to, every process compiles.
    with suppress(OSError, KnownError):
        write_atomically(_file(method), [pickle.dumps(wanted)])


def _file(method: str) -> Path:
    """Beside the compiled kernels."""
    kept = folder()
    if kept is None:
        raise KnownError("no kernel is kept on disk")
    return kept / f"{method}-{_warm_up_digest():08x}.pickle"


@cache
def _warm_up_digest() -> int:
    """Which kernels are needed depends on what a warm-up does."""
    return zlib.crc32(Path(__file__).with_name("warm_up.py").read_bytes())
