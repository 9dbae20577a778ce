"""Options of the camera sources, and their conversion."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UserError, one_line
from .source_options import StampChoice

if TYPE_CHECKING:
    from comotion_sources.calibration import Calibration
    from comotion_sources.klt import TrackerConfig


What = Annotated[
    str,
    typer.Argument(
        metavar="WHAT",
        help="A number or /dev/videoN (webcam), a video file, a URL (RTSP, HTTP), a folder of images or of "
        "TUM RGB-D (rgb.txt), realsense[:SERIAL], or workcell:SCENE/CAMERA.",
        show_default=False,
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        "--rate",
        envvar="COMOTION_RATE",
        min=0.1,
        max=1000,
        metavar="HZ",
        help="Most frames per second; also requested from devices and assumed for folders of images.",
    ),
]
MaxFeatures = Annotated[
    int, typer.Option("--max-features", envvar="COMOTION_MAX_FEATURES", min=1, help="Features in the image.")
]
RespawnEvery = Annotated[
    int,
    typer.Option(
        "--respawn-every",
        envvar="COMOTION_RESPAWN_EVERY",
        min=1,
        metavar="FRAMES",
        help="Frames between two searches for new corners.",
    ),
]
Tracker = Annotated[
    list[str] | None,
    typer.Option(
        "--tracker",
        envvar="COMOTION_TRACKER",
        metavar="NAME=VALUE",
        help="Set a tracker parameter, e.g. fb_absolute=0.5, max_step=0.05; may be repeated. "
        "An unknown name lists all parameters.",
    ),
]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        "--intrinsics",
        envvar="COMOTION_CALIBRATION",
        metavar="FILE",
        help="Intrinsics (and extrinsics): comotion TOML, OpenCV YAML or ROS camera_info YAML.",
    ),
]
ExtrinsicsFile = Annotated[
    Path | None,
    typer.Option(
        "--extrinsics",
        envvar="COMOTION_EXTRINSICS",
        metavar="FILE.toml|identity",
        help="Pose of the camera, written by 'comotion calibrate'; 'identity': the origin of world.",
    ),
]
Moving = Annotated[
    bool,
    typer.Option(
        "--moving/--fixed",
        envvar="COMOTION_MOVING",
        help="The camera is carried: what is published is relative to the largest body, the world.",
    ),
]
Poses = Annotated[
    Path | None,
    typer.Option(
        "--poses",
        envvar="COMOTION_POSES",
        metavar="FILE",
        help="Pose of the camera over time, as TUM RGB-D's groundtruth.txt; with --stamps original.",
    ),
]
CarriedBy = Annotated[
    str | None,
    typer.Option(
        "--carried-by",
        envvar="COMOTION_CARRIED_BY",
        metavar="SOURCE:ID",
        help="The 6-DoF feature that carries the camera, such as a link of 'source proprioception'. "
        "--extrinsics is then the pose of the camera on it.",
    ),
]
Space = Annotated[
    str | None,
    typer.Option(
        "--space",
        envvar="COMOTION_SPACE",
        help="Coordinate space. Default: NAME/pixels without depth, the frame of the extrinsics ('world') "
        "with depth and extrinsics, else NAME/optical.",
    ),
]
Depth = Annotated[
    bool, typer.Option("--depth/--no-depth", envvar="COMOTION_DEPTH", help="Use depth if available.")
]
PreviewPath = Annotated[
    Path | None,
    typer.Option(
        "--preview",
        envvar="COMOTION_PREVIEW",
        metavar="FILE.mp4|DIR",
        help="Write an annotated video, or PNG images to a folder, with features coloured by hypothesis.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite", envvar="COMOTION_OVERWRITE", help="Remove the frames of an earlier run from a folder."
    ),
]
SharePreview = Annotated[
    float,
    typer.Option(
        "--share-preview",
        envvar="COMOTION_SHARE_PREVIEW",
        min=0,
        max=60,
        metavar="HZ",
        help="Images per second for viewers and recorders that subscribe to them; 0: none.",
    ),
]
Realtime = Annotated[
    bool,
    typer.Option(
        "--realtime/--no-realtime",
        envvar="COMOTION_REALTIME",
        help="Play recordings at their recorded rate, or as fast as they can be tracked (for a service with "
        "--clock event).",
    ),
]
Loop = Annotated[bool, typer.Option("--loop", envvar="COMOTION_LOOP", help="Repeat a recording.")]
Stamps = Annotated[
    StampChoice,
    typer.Option(
        "--stamps",
        envvar="COMOTION_STAMPS",
        help="Stamps of recordings: as if taken now, or those of the file (media time if it has none).",
    ),
]
Reconnect = Annotated[
    bool,
    typer.Option(
        "--reconnect/--no-reconnect",
        envvar="COMOTION_RECONNECT",
        help="Reopen a lost device, or end.",
    ),
]
ClockOffset = Annotated[
    float,
    typer.Option(
        "--clock-offset",
        envvar="COMOTION_CLOCK_OFFSET",
        metavar="SECONDS",
        help="Added to every stamp, for a camera with a known clock offset.",
    ),
]


def clear_frames(folder: Path | None, *, overwrite: bool) -> None:
    """Remove the frames that an earlier run has written; on a terminal, ask before.

    Raises
    ------
    UserError
        If there are any, and nobody has agreed to remove them.
    """
    from comotion_sources.klt.picture_file import frames_in

    frames = [] if folder is None else frames_in(folder)
    if not frames:
        return
    held = f"{folder} holds {len(frames)} frames of an earlier run"
    if not overwrite and not (sys.stdin.isatty() and typer.confirm(f"{held}. Remove them?", err=True)):
        raise UserError(f"{held}: --overwrite removes them")
    for frame in frames:
        frame.unlink()


def tracker_config(
    max_features: int, respawn_every: int, assignments: list[str] | None = None, *, moving: bool = False
) -> "TrackerConfig":
    """Build the parameters of the tracker.

    Raises
    ------
    UserError
        If a parameter is unknown or a value is out of bounds.
    """
    from pydantic import ValidationError

    from comotion_sources.klt import TrackerConfig

    values: dict[str, Any] = {"max_features": max_features, "respawn_every": respawn_every, "moving": moving}
    for text in assignments or ():
        name, separator, value = text.partition("=")
        if not separator:
            raise UserError(f"--tracker {text}: expected NAME=VALUE")
        values[name.strip().replace("-", "_")] = None if value.strip() == "null" else value
    try:
        return TrackerConfig(**values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = ".".join(str(part) for part in first["loc"][:1])
        if first["type"] == "extra_forbidden":
            known = ", ".join(sorted(TrackerConfig.model_fields))
            raise UserError(f"unknown tracker parameter {name!r}; one of {known}") from None
        raise UserError(f"tracker parameter {name}: {one_line(first['msg'])}") from None


def read_calibration(calibration: Path | None, extrinsics: Path | None) -> "Calibration":
    """Read both calibration files; the extrinsics of the second file take precedence.

    Raises
    ------
    CalibrationError
        If a file cannot be read.
    UserError
        If the second file has no extrinsics.
    """
    from comotion_sources.calibration import Calibration, Extrinsics
    from comotion_sources.calibration import read_calibration as read

    first = Calibration() if calibration is None else read(calibration)
    if extrinsics is None:
        return first
    if str(extrinsics) == "identity":
        return Calibration(first.intrinsics, Extrinsics())
    second = read(extrinsics)
    if second.extrinsics is None:
        raise UserError(f"{extrinsics}: has no [extrinsics]")
    return Calibration(first.intrinsics or second.intrinsics, second.extrinsics)
