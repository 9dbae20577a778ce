"""The compiled kernels of the core."""

import sys

from numba.core.dispatcher import Dispatcher


def kernels() -> dict[str, Dispatcher]:
    """Every kernel of the core that this process has imported, by ``module:name``."""
    modules = [module for name, module in sys.modules.items() if name.startswith("comotion.")]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher))
    return {f"{one.py_func.__module__}:{one.py_func.__qualname__}": one for one in found}
