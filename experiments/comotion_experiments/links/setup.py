"""Set-up of the link experiment: an RGB-D camera and a camera without depth."""

from dataclasses import dataclass

from ..fusion.setup import Filming

SCENES = ("truck", "shelf", "arm", "truck-clutter", "shelf-clutter", "arm-clutter")

DEPTH_CAMERA, PLAIN_CAMERA = "klt-a", "klt-b"
"""Names of the sources: camera a of the scene with depth, camera b without."""
PLAIN_SPACE = f"{PLAIN_CAMERA}/pixels"


@dataclass(frozen=True, kw_only=True)
class Setup(Filming):
    """Two cameras of one rate, Hz."""

    rate: float = 15.0
    features: int = 250


QUICK = Setup(size=(320, 240), features=150, duration=12.0)
"""Smaller images and a shorter run, for a first look."""
