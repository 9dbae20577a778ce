"""Which engine serves which method and kind of space."""

from .config import FusionConfig
from .partition import Engine, IdAllocator, SpaceSpec
from .pixels.method import PixelEngine
from .rigid.method import MotionEngine
from .thesis.method import ThesisEngine


def make_engine(config: FusionConfig, spec: SpaceSpec, ids: IdAllocator) -> Engine:
    """Engine of `config.method` for one space."""
    # Pixels with a third coordinate (a disparity) are no image plane: rigid motion is the better model.
    if config.method == "comotion" and spec.unit == "px" and spec.dim == 2:
        return PixelEngine(config, spec, ids)
    if config.method == "comotion":
        return MotionEngine(config, spec, ids)
    return ThesisEngine(config, spec, ids)
