"""Every parameter of the fusion, nested by method, with unit, default and bounds."""

from .fusion import FusionConfig, Method, put, read_config, to_ns
from .groups import (
    Camera,
    Clustering,
    HypothesesConfig,
    JointsConfig,
    LimitsConfig,
    LinkingConfig,
    PixelsConfig,
    RigidConfig,
    SpaceConfig,
    ThesisConfig,
    Unit,
)

__all__ = [
    "Camera",
    "Clustering",
    "FusionConfig",
    "HypothesesConfig",
    "JointsConfig",
    "LimitsConfig",
    "LinkingConfig",
    "Method",
    "PixelsConfig",
    "RigidConfig",
    "SpaceConfig",
    "ThesisConfig",
    "Unit",
    "put",
    "read_config",
    "to_ns",
]
