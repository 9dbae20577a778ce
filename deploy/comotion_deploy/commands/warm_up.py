"""``comotion dev warm-up``: compile everything now, so that no first start has to."""

import time
from dataclasses import dataclass

from ..errors import UserError
from ..options import Tool, option


@dataclass(kw_only=True)
class WarmUp(Tool):
    """Compile all kernels: some minutes once, some seconds when it has been done.

    The result is kept on disk, in NUMBA_CACHE_DIR if that is set. 'make setup' and the container image
    have done it.
    """

    epilog = """
Examples:
  comotion dev warm-up
  NUMBA_CACHE_DIR=/var/cache/comotion comotion dev warm-up   # when an image is built
"""
    log_level = "warning"

    method: list[str] | None = option(None, "Methods to compile for: comotion, thesis. Default: both.")

    def run(self) -> None:
        """Compile for each method."""
        from comotion import FusionConfig
        from comotion.warm_up import prepare

        from ..compiling import show_progress

        begun = time.monotonic()
        for name in self.method or ("comotion", "thesis"):
            try:
                config = FusionConfig.model_validate({"method": name})
            except ValueError:
                raise UserError(f"unknown method {name!r}; one of comotion, thesis") from None
            show_progress(name, prepare(config))
            print(f"{name}: compiled, {time.monotonic() - begun:.0f} s", flush=True)
