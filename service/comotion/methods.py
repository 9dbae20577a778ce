"""Which engine serves which method and kind of space."""

from .config import FusionConfig
from .engine import Engine, IdAllocator, SpaceSpec
from .thesis import ThesisEngine


def make_engine(config: FusionConfig, spec: SpaceSpec, ids: IdAllocator) -> Engine:
    """Engine of `config.method` for one space."""
    return ThesisEngine(config, spec, ids)
