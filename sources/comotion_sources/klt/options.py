"""What a user says about a camera source, and the space that follows from it."""

from dataclasses import dataclass, field
from pathlib import Path

from comotion_schemas import DEFAULT_SCENE
from comotion_schemas.transport import SessionSettings

from ..calibration.files import Calibration, CalibrationError
from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Camera
from ..markers.detector import MarkerOptions
from .config import TrackerConfig
from .observer import CameraSpace, choose_space
from .pacing import Pacing


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """What a user says about a camera source.

    Attributes
    ----------
    name
        Name of the source; markers are a source of their own, ``<name>-markers``.
    tracker
        Parameters of the tracker.
    pacing
        How frames become observations.
    calibration
        Wins over what the camera knows about itself.
    use_depth
        False: publish pixels even if there is depth.
    space
        Name of the space; None: see :func:`choose_space`.
    fixed
        The camera must know where it is: refuse to publish metres without extrinsics.
    loop
        Start a recording again at its end.
    reconnect
        Open a device again when it is lost.
    preview
        Annotated video or folder of PNGs to write.
    share_preview
        Most images a second for those who subscribe to them; 0: none.
    markers
        Fiducial markers to look for; None: none.
    """

    name: str = "klt"
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    pacing: Pacing = field(default_factory=Pacing)
    calibration: Calibration = field(default_factory=Calibration)
    use_depth: bool = True
    space: str | None = None
    fixed: bool = False
    loop: bool = False
    reconnect: bool = True
    preview: Path | None = None
    share_preview: float = 5.0
    markers: MarkerOptions | None = None


@dataclass(frozen=True, kw_only=True)
class Wire:
    """Where a source publishes, and whom it tells that it does."""

    scene: str = DEFAULT_SCENE
    settings: SessionSettings | None = None
    ready_file: Path | None = None


def space_of(
    camera: Camera, options: CameraOptions, intrinsics: Intrinsics | None, extrinsics: Extrinsics | None
) -> CameraSpace:
    """Choose the space that a camera publishes in, calibrated as it is.

    Raises
    ------
    CalibrationError
        If a fixed camera that needs its extrinsics has none.
    CameraError
        If there is depth but no intrinsics to lift it with.
    """
    has_depth = camera.has_depth and options.use_depth
    if options.fixed and extrinsics is None and (has_depth or options.markers is not None):
        raise CalibrationError(
            "an external camera needs its extrinsics: --extrinsics FILE ('comotion calibrate' makes it)"
        )
    return choose_space(
        options.name,
        has_depth=has_depth,
        intrinsics=intrinsics,
        extrinsics=extrinsics,
        name=options.space,
    )
