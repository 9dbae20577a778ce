"""``comotion segment``: draws the objects of a video, offline."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .. import options
from ..errors import UserError, require_dense
from ..fusion_options import fusion_config
from . import camera_options as camera

if TYPE_CHECKING:
    from comotion_experiments.segment import Progress, Segmented

EPILOG = """
Examples:

  comotion segment drawer.mp4   # writes drawer-segmented.mp4

  comotion segment drawer.mp4 --out out.mp4 --csv tracks.csv

  comotion segment rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --csv tracks.csv

  comotion segment rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --moving --trajectory camera.txt

  comotion segment drawer.mp4 --masks masks   # the hypothesis of every pixel

  comotion segment "workcell:truck/a?duration=5" --json
"""


def segment(
    ctx: typer.Context,
    what: Annotated[
        str,
        typer.Argument(
            metavar="WHAT",
            help="A video file, a folder of images or of TUM RGB-D (rgb.txt), or workcell:SCENE/CAMERA.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            envvar="COMOTION_OUT",
            metavar="FILE.mp4|DIR",
            help="Annotated video, or folder of PNG images. Default: WHAT-segmented.mp4, unless --csv or "
            "--json is given.",
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            envvar="COMOTION_CSV",
            metavar="FILE.csv",
            help="Table: frame, time, feature, x, y, hypothesis (-1: undetermined), confidence.",
        ),
    ] = None,
    rate: camera.Rate = None,
    max_features: camera.MaxFeatures = 400,
    respawn_every: camera.RespawnEvery = 15,
    tracker: camera.Tracker = None,
    calibration: camera.CalibrationFile = None,
    extrinsics: camera.ExtrinsicsFile = None,
    depth: camera.Depth = True,
    moving: camera.Moving = False,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            "--trajectory",
            envvar="COMOTION_TRAJECTORY",
            metavar="FILE",
            help="With --moving and depth: where the camera was, as TUM RGB-D's groundtruth.txt.",
        ),
    ] = None,
    masks: Annotated[
        Path | None,
        typer.Option(
            "--masks",
            envvar="COMOTION_MASKS",
            metavar="DIR",
            help="Write the hypothesis of every pixel, as PNG of 16 bits (0: none). Needs scikit-image.",
        ),
    ] = None,
    masks_every: Annotated[
        float,
        typer.Option("--masks-every", envvar="COMOTION_MASKS_EVERY", min=0, max=3600, help="s between them."),
    ] = 0.5,
    overwrite: camera.Overwrite = False,
    method: options.Method = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Track and group every frame of a video, and draw the result.

    No router and no other process is needed. The same video gives the same labels on every run.
    """
    import cv2

    from comotion_experiments.labelled import SegmentOptions
    from comotion_experiments.segment import segment as run
    from comotion_sources.klt.picture_file import NO_ENCODER

    cv2.setNumThreads(1)  # the work of one frame is too small to be worth waking other cores for
    if trajectory is not None and not moving:
        raise UserError("--trajectory needs --moving")
    if masks is not None:
        require_dense()
    if all(one is None for one in (out, csv, trajectory, masks)) and not json_:
        out = Path(f"{_stem(what)}-segmented.mp4")
    _check_outputs(what, out, csv, trajectory)
    for folder in (out, masks):
        camera.clear_frames(folder, overwrite=overwrite)
    how = SegmentOptions(
        out=out,
        csv=csv,
        masks=masks,
        masks_every=masks_every,
        tracker=camera.tracker_config(max_features, respawn_every, tracker, moving=moving),
        fusion=fusion_config(ctx, method, assignments),
        rate=rate,
        calibration=camera.read_calibration(calibration, extrinsics),
        use_depth=depth,
    )
    with _progress(what, how.fusion.method) as progress:
        found = run(what, how, progress)
    if trajectory is not None:
        _write_trajectory(trajectory, found)
    if json_:
        import json

        print(json.dumps(found.as_json(), indent=2))
        return
    _print_summary(found)
    for path in (out, csv, trajectory, masks):
        if path is not None:
            print(f"wrote {path}")
    if found.codec == "mpeg4":
        print(f"the video is {NO_ENCODER}")


def _write_trajectory(path: Path, found: "Segmented") -> None:
    """Write where the camera was: ``stamp tx ty tz qx qy qz qw`` a line."""
    lines = ["# stamp tx ty tz qx qy qz qw"]
    for stamp_ns, pose in found.path:
        if isinstance(pose.rotation, list):
            values = " ".join(f"{value:.6f}" for value in (*pose.translation, *pose.rotation))
            lines.append(f"{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d} {values}")
    try:
        path.write_text("\n".join(lines) + "\n")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from None


def _stem(what: str) -> str:
    name = what.removeprefix("workcell:").partition("?")[0].replace("/", "-") if ":" in what else ""
    return name or Path(what).resolve().stem


def _check_outputs(what: str, *paths: Path | None) -> None:
    """Refuse to write over the input."""
    for path in paths:
        if path is not None and path.exists() and Path(what).exists() and path.samefile(what):
            raise UserError(f"{path}: is the input")


def _print_summary(found: "Segmented") -> None:
    speed = found.frames / found.seconds
    times = f", {found.duration / found.seconds:.1f} times real time" if found.duration else ""
    print(f"{found.frames} frames in {found.seconds:.1f} s: {speed:.0f} frames/s{times}")
    print(f"{len(found.hypotheses)} hypotheses, {len([h for h in found.last if not h.absent])} at the end")


@contextmanager
def _progress(what: str, method: str) -> "Iterator[Progress]":
    """One line on standard error: it changes on a terminal; elsewhere there is one every few seconds."""
    from comotion.library.compiling import compile_ahead
    from comotion_clients.progress import reporting

    compile_ahead(method, "px", 2)
    name = Path(what).name
    with reporting(quiet=False, terminal_s=0.25, plain_s=3.0) as report:
        yield lambda done, total: report(
            lambda: f"{name}: frame {done}" + ("" if total is None else f" of {total}")
        )
