"""Set-up of the fusion experiment: scenes, sources, rates, and the cover of camera A."""

from dataclasses import dataclass

SCENES = ("truck", "truck-tower", "shelf", "arm")

CAMERA_A, CAMERA_B, ROBOT = "klt-a", "klt-b", "robot"
"""Names of the sources: two RGB-D cameras, and the proprioception of the scene's robot."""


@dataclass(frozen=True)
class Variant:
    """Sources that are fused together.

    Attributes
    ----------
    name
        As in the table.
    sources
        Names of the sources.
    """

    name: str
    sources: tuple[str, ...]


ALONE_A = Variant("A", (CAMERA_A,))
ALONE_B = Variant("B", (CAMERA_B,))
WITH_ROBOT = Variant("A + robot", (CAMERA_A, ROBOT))
ALL = Variant("A + B + robot", (CAMERA_A, CAMERA_B, ROBOT))
VARIANTS = (ALONE_A, ALONE_B, WITH_ROBOT, ALL)


@dataclass(frozen=True)
class Setup:
    """Image size, rates, features, cover and duration.

    Attributes
    ----------
    size
        Width and height of the images in pixels.
    rate_a, rate_b, rate_robot
        Hz.
    features
        Feature budget of each camera.
    cover
        Start and end, in seconds, of the time during which camera A is covered.
    duration
        Seconds; None: one period of the scene.
    """

    size: tuple[int, int] = (480, 360)
    rate_a: float = 30.0
    rate_b: float = 15.0
    rate_robot: float = 200.0
    features: int = 150
    cover: tuple[float, float] = (7.5, 10.5)
    duration: float | None = None


QUICK = Setup(size=(320, 240), features=100, duration=14.0)
"""Smaller images and a shorter run, for a first look."""
