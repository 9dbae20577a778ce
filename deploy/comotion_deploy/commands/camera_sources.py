"""``comotion source klt`` and ``external-camera``, and the options of all that reads a camera."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import UserError, one_line
from ..network import Process
from ..options import Command, argument, assignment, setting
from .played_sources import Stamps

if TYPE_CHECKING:
    from comotion_sources.calibration.files import Calibration
    from comotion_sources.klt.config import TrackerConfig


class Camera(Command):
    """Options of a command that tracks the features of a camera or of its recording."""

    rate: float | None = setting(
        None,
        "Most frames per second; also requested from devices and assumed for folders of images.",
        min=0.1,
        max=1000,
        metavar="HZ",
    )
    max_features: int = setting(400, "Features in the image.", min=1)
    respawn_every: int = setting(5, "Frames between two searches for new corners.", min=1, metavar="FRAMES")
    tracker: list[str] | None = setting(
        None,
        "Set a tracker parameter, e.g. fb_absolute=0.5, likeness=0.9; may be repeated. "
        "An unknown name lists all parameters.",
        metavar="NAME=VALUE",
    )
    calibration: Path | None = setting(
        None,
        "Intrinsics (and extrinsics): comotion TOML, OpenCV YAML or ROS camera_info YAML.",
        "--calibration",
        "--intrinsics",
        metavar="FILE",
    )
    extrinsics: Path | None = setting(
        None,
        "Pose of the camera, written by 'comotion calibrate'; 'identity': the origin of world.",
        metavar="FILE.toml|identity",
    )
    depth: bool = setting(True, "Use depth if available.")
    overwrite: bool = setting(False, "Remove the frames of an earlier run from a folder.")

    def tracker_config(self, *, moving: bool) -> "TrackerConfig":
        """Build the parameters of the tracker.

        Raises
        ------
        UserError
            If a parameter is unknown or a value is out of bounds.
        """
        from pydantic import ValidationError

        from comotion_sources.klt.config import TrackerConfig

        values: dict[str, Any] = {
            "max_features": self.max_features,
            "respawn_every": self.respawn_every,
            "moving": moving,
        }
        values |= dict(assignment(text, "--tracker") for text in self.tracker or ())
        try:
            return TrackerConfig(**values)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = ".".join(str(part) for part in first["loc"][:1])
            if first["type"] == "extra_forbidden":
                names = ", ".join(sorted(TrackerConfig.model_fields))
                raise UserError(f"unknown tracker parameter {name!r}; one of {names}") from None
            raise UserError(f"tracker parameter {name}: {one_line(first['msg'])}") from None

    def clear_frames(self, folder: Path | None) -> None:
        """Remove the frames that an earlier run has written; on a terminal, ask before.

        Raises
        ------
        UserError
            If there are any, and nobody has agreed to remove them.
        """
        from comotion_schemas.text import counted
        from comotion_sources.klt.picture_file import frames_in

        frames = [] if folder is None else frames_in(folder)
        if not frames:
            return
        held = f"{folder} holds {counted(len(frames), 'frame')} of an earlier run"
        if not self.overwrite and not (
            sys.stdin.isatty() and typer.confirm(f"{held}. Remove them?", err=True)
        ):
            raise UserError(f"{held}: --overwrite removes them")
        for frame in frames:
            frame.unlink()


class Carried(Camera):
    """The option of a command whose camera may move."""

    moving: bool = setting(
        False,
        "The camera is carried: what is published is relative to the largest body, the world.",
        "--moving/--fixed",
    )


class CameraSource(Camera, Process):
    """Options of a source that tracks the features of a camera."""

    what: str = argument(
        ...,
        "WHAT",
        "A number or /dev/videoN (webcam), a video file, a URL (RTSP, HTTP), a folder of images or of "
        "TUM RGB-D (rgb.txt), realsense[:SERIAL], or workcell:SCENE/CAMERA.",
    )
    space: str | None = setting(
        None,
        "Coordinate space. Default: NAME/pixels without depth, the frame of the extrinsics ('world') "
        "with depth and extrinsics, else NAME/optical.",
    )
    preview: Path | None = setting(
        None,
        "Write an annotated video, or PNG images to a folder, with features coloured by hypothesis.",
        metavar="FILE.mp4|DIR",
    )
    share_preview: float = setting(
        5.0,
        "Images per second for viewers and recorders that subscribe to them; 0: none.",
        min=0,
        max=60,
        metavar="HZ",
    )
    realtime: bool = setting(
        True,
        "Play recordings at their recorded rate, or as fast as they can be tracked (for a service with "
        "--clock event).",
    )
    loop: bool = setting(False, "Repeat a recording.")
    stamps: Stamps = setting(
        "now", "Stamps of recordings: as if taken now, or those of the file (media time if it has none)."
    )
    reconnect: bool = setting(True, "Reopen a lost device, or end.")
    clock_offset: float = setting(
        0.0, "Added to every stamp, for a camera with a known clock offset.", metavar="SECONDS"
    )

    def publish(self, *, moving: bool, **others: Any) -> None:
        """Publish what the camera sees until stopped, or to the end of its recording.

        Parameters
        ----------
        moving
            Whether the camera is carried.
        others
            Options of the camera's process that are not simply fields of the command.
        """
        from comotion_sources.klt.options import CameraOptions
        from comotion_sources.klt.process import run

        self.clear_frames(self.preview)
        options = self.call(
            CameraOptions,
            tracker=self.tracker_config(moving=moving),
            offset_ns=round(self.clock_offset * 1e9),
            calibration=read_calibration(self.calibration, self.extrinsics),
            use_depth=self.depth,
            **others,
        )
        run(self.what, options, **self.where())


class Klt(Carried, CameraSource):
    """Track the features of a camera, video or RGB-D recording and publish them."""

    epilog = """
Examples:
  comotion source klt 0   # a webcam, in the space klt/pixels
  comotion source klt drawer.mp4 --preview tracked.mp4
  comotion source klt rtsp://camera/stream --name door --max-features 300
  comotion source klt rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --extrinsics a.toml
  comotion source klt workcell:truck/a --name camera-a
  comotion source klt rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --moving
  comotion source klt workcell:eye-in-hand/hand --carried-by robot:3 --extrinsics mount.toml
"""
    name = "klt"

    poses: Path | None = setting(
        None,
        "Pose of the camera over time, as TUM RGB-D's groundtruth.txt; with --stamps original.",
        metavar="FILE",
    )
    carried_by: str | None = setting(
        None,
        "The 6-DoF feature that carries the camera, such as a link of 'source proprioception'. "
        "--extrinsics is then the pose of the camera on it.",
        metavar="SOURCE:ID",
    )

    def run(self) -> None:
        """Publish until stopped, or to the end of the recording."""
        from comotion_sources.poses import parse_carrier

        carrier = None if self.carried_by is None else parse_carrier(self.carried_by)
        moving = self.moving or self.poses is not None or carrier is not None
        self.publish(moving=moving, carrier=carrier)


class ExternalCamera(CameraSource):
    """Publish features and fiducial markers of a fixed camera."""

    epilog = """
Examples:
  comotion calibrate 0 1 --target chessboard:9x6:0.025 --calibration-a a.toml --calibration-b b.yaml -o x.toml
  comotion source external-camera 1 --calibration b.yaml --extrinsics x.toml --marker-size 0.05
  comotion source external-camera workcell:truck/b --name camera-b --rate 15
"""
    name = "external"

    marker_size: float | None = setting(
        None,
        "Detect markers with a black square of this edge; they are published as NAME-markers.",
        metavar="METRES",
    )
    dictionary: str = setting(
        "4x4_50", "Marker dictionary, e.g. 4x4_50 or apriltag_36h11; an unknown name lists all."
    )

    def run(self) -> None:
        """Publish until stopped, or to the end of the recording."""
        from comotion_sources.markers import MarkerOptions

        markers = None if self.marker_size is None else MarkerOptions(self.marker_size, self.dictionary)
        self.publish(moving=False, fixed=True, markers=markers)


def read_calibration(calibration: Path | None, extrinsics: Path | None) -> "Calibration":
    """Read both calibration files; the extrinsics of the second file take precedence.

    Raises
    ------
    InputError
        If a file cannot be read.
    UserError
        If the second file has no extrinsics.
    """
    from comotion_sources.calibration.files import Calibration
    from comotion_sources.calibration.files import read_calibration as read
    from comotion_sources.calibration.model import Extrinsics

    first = Calibration() if calibration is None else read(calibration)
    if extrinsics is None:
        return first
    if str(extrinsics) == "identity":
        return Calibration(first.intrinsics, Extrinsics())
    second = read(extrinsics)
    if second.extrinsics is None:
        raise UserError(f"{extrinsics}: has no [extrinsics]")
    return Calibration(first.intrinsics or second.intrinsics, second.extrinsics)
