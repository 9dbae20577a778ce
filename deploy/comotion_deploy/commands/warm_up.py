"""``comotion dev warm-up``: compile everything now, so that no first start has to."""

from typing import Annotated

import typer

from .. import options
from ..errors import UserError

EPILOG = """
Examples:

  comotion dev warm-up

  NUMBA_CACHE_DIR=/var/cache/comotion comotion dev warm-up   # when an image is built
"""


def warm_up(
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="Methods to compile for: comotion, thesis. Default: both."),
    ] = None,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Compile all kernels: some minutes once, some seconds when it has been done.

    The result is kept on disk, in NUMBA_CACHE_DIR if that is set. 'make setup' and the container image
    have done it.
    """
    import time

    from comotion import FusionConfig
    from comotion.runtime.warm_up import prepare

    from ..compiling import show_progress

    begun = time.monotonic()
    for name in method or ("comotion", "thesis"):
        try:
            config = FusionConfig.model_validate({"method": name})
        except ValueError:
            raise UserError(f"unknown method {name!r}; one of comotion, thesis") from None
        show_progress(name, prepare(config))
        print(f"{name}: compiled, {time.monotonic() - begun:.0f} s", flush=True)
