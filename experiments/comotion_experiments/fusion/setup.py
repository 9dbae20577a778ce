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


@dataclass(frozen=True, kw_only=True)
class Filming:
    """How cameras film a scene: `size` of the images (px), `features` of each camera, `duration`.

    The duration is in seconds; None: one period of the scene.
    """

    size: tuple[int, int] = (480, 360)
    features: int = 150
    duration: float | None = None


@dataclass(frozen=True, kw_only=True)
class Setup(Filming):
    """Two cameras and a robot: their rates in Hz, and begin and end (s) of the cover of camera A."""

    rate_a: float = 30.0
    rate_b: float = 15.0
    rate_robot: float = 200.0
    cover: tuple[float, float] = (7.5, 10.5)


QUICK = Setup(size=(320, 240), features=100, duration=14.0)
"""Smaller images and a shorter run, for a first look."""
