"""Options of a camera source."""

from dataclasses import dataclass, field
from pathlib import Path

from ..calibration.files import Calibration
from ..markers.detector import MarkerOptions
from .config import TrackerConfig
from .pacing import Pacing


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Options of a camera source.

    Attributes
    ----------
    name
        Name of the source; its markers are the separate source ``<name>-markers``.
    tracker
        Parameters of the tracker.
    pacing
        When frames are due, and their stamps.
    calibration
        Takes precedence over the calibration that the camera reports.
    use_depth
        False: publish pixels although there is depth.
    space
        Name of the space; None: see :func:`choose_space`.
    fixed
        Require extrinsics for publishing metres.
    loop
        Repeat a recording from its start.
    reconnect
        Reopen a device that is lost.
    preview
        Path of an annotated video, or a folder for PNG images; None: none.
    share_preview
        Most images per second that subscribers get; 0: none.
    markers
        Fiducial markers to detect; None: none.
    poses, carrier
        A trajectory file with the pose of every frame, or source and id of the 6-DoF feature that carries the
        camera; the extrinsics then lead from the camera to what these are poses of.
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
    poses: Path | None = None
    carrier: tuple[str, int] | None = None

    @property
    def posed(self) -> bool:
        """Whether the pose of every frame is known."""
        return self.poses is not None or self.carrier is not None
