"""Set-up of the link experiment: an RGB-D camera and a camera without depth."""

from dataclasses import dataclass

SCENES = ("truck", "shelf", "arm", "truck-clutter", "shelf-clutter", "arm-clutter")

DEPTH_CAMERA, PLAIN_CAMERA = "klt-a", "klt-b"
"""Names of the sources: camera a of the scene with depth, camera b without."""
PLAIN_SPACE = f"{PLAIN_CAMERA}/pixels"


@dataclass(frozen=True)
class Setup:
    """Image size, rate, features and duration.

    Attributes
    ----------
    size
        Width and height of the images in pixels.
    rate
        Hz, of both cameras.
    features
        Feature budget of each camera.
    duration
        Seconds; None: one period of the scene.
    """

    size: tuple[int, int] = (480, 360)
    rate: float = 15.0
    features: int = 250
    duration: float | None = None


QUICK = Setup(size=(320, 240), features=150, duration=12.0)
"""Smaller images and a shorter run, for a first look."""
