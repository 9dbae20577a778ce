"""Every parameter of the fusion, nested by method, with unit, default and bounds."""

from .fusion import FusionConfig, Method, to_ns
from .hypotheses import HypothesesConfig
from .joints import JointsConfig
from .limits import LimitsConfig
from .linking import Camera, LinkingConfig
from .pixels import PixelsConfig
from .reading import put, read_config
from .rigid import RigidConfig
from .spaces import SpaceConfig
from .thesis import Clustering, ThesisConfig, Unit

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
