"""``comotion segment``: draws the objects of a video, offline."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UserError, require_suffix
from ..options import Fusion, Json, Tool, argument, setting
from .camera_sources import Carried, read_calibration
from .look import BodyNames

if TYPE_CHECKING:
    from comotion_experiments.labelled import SegmentOptions
    from comotion_sources.recordings import Recording

_OWN_TRACKER = ("max_features", "respawn_every", "tracker", "calibration", "extrinsics")
_ANY_RATE = 30.0


class Segment(BodyNames, Carried, Fusion, Json, Tool):
    """Track and group every frame of a video, and draw the result.

    No router and no other process is needed. The same video gives the same labels on every run.
    """

    epilog = """
Examples:
  comotion segment drawer.mp4   # writes drawer-segmented.mp4
  comotion segment drawer.mp4 --out out.mp4 --csv tracks.csv
  comotion segment rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --csv tracks.csv
  comotion segment rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --moving --trajectory camera.txt
  comotion segment drawer.mp4 --sheet drawer.jpg   # the whole video on one page
  comotion segment drawer.mp4 --masks masks   # the hypothesis of every pixel
  comotion segment apple.mp4 --tracks apple.npz   # of CoTracker or TAPIR, in place of our own tracker
  comotion segment --tracks apple.npz --fps 30 --csv labels.csv
  comotion segment drawer.mp4 --name 3=drawer   # the same video has the same ids on every run
  comotion segment "workcell:truck/a?duration=5" --json
"""
    log_level = "warning"

    what: str | None = argument(
        None,
        "WHAT",
        "A video file, a folder of images or of TUM RGB-D (rgb.txt), or workcell:SCENE/CAMERA. With --tracks "
        "it may be left out: they are drawn on black.",
    )
    tracks: Path | None = setting(
        None,
        "Tracks of the frames of WHAT by another tracker, .npz, .npy or .csv: CoTracker, TAPIR and the like.",
        metavar="FILE",
    )
    fps: float | None = setting(
        None, "Frames per second of --tracks without WHAT, if the file has no times.", min=0.01, max=10_000
    )
    out: Path | None = setting(
        None,
        "Annotated video, or folder of PNG images. Default: WHAT-segmented.mp4, unless --csv, "
        "--sheet or --json is given.",
        metavar="FILE.mp4|DIR",
    )
    csv: Path | None = setting(
        None,
        "Table: frame, time, feature, x, y, hypothesis (-1: undetermined), confidence.",
        metavar="FILE.csv",
    )
    sheet: Path | None = setting(
        None, "One page with twelve pictures of the whole video.", metavar="FILE.jpg"
    )
    trajectory: Path | None = setting(
        None, "With --moving and depth: where the camera was, as TUM RGB-D's groundtruth.txt.", metavar="FILE"
    )
    masks: Path | None = setting(
        None,
        "Write the hypothesis of every pixel, as PNG of 16 bits (0: none).",
        metavar="DIR",
    )
    masks_every: float = setting(0.5, "Time between them.", min=0, max=3600, metavar="SECONDS")

    def run(self) -> None:
        """Segment the video and say what was written."""
        options = self._options()
        import cv2

        from comotion_clients.formats import line
        from comotion_experiments.segment import segment
        from comotion_schemas.terminal import reporting
        from comotion_schemas.text import counted
        from comotion_sources.klt.picture_file import NO_ENCODER

        cv2.setNumThreads(1)  # the work of one frame is too small to be worth waking other cores for
        name = Path(str(self.what or self.tracks)).name
        with reporting() as report:
            result = segment(
                self.what,
                options,
                lambda done, total: report(lambda: f"{name}: frame {done}{f' of {total}' if total else ''}"),
            )
        if self.trajectory is not None:
            lines = [
                "# stamp tx ty tz qx qy qz qw",
                *(line(stamp_ns, pose) for stamp_ns, pose in result.path),
            ]
            self.trajectory.write_text("\n".join(lines) + "\n")
        times = f", {result.duration / result.seconds:.1f} times real time" if result.duration else ""
        at_end = len([h for h in result.last if not h.absent])
        lines = [
            f"{counted(result.frames, 'frame')} in {result.seconds:.1f} s: "
            f"{result.frames / result.seconds:.0f} frames/s{times}",
            f"{counted(len(result.hypotheses), 'hypothesis')}, {at_end} at the end",
            *result.joints,
            *(f"wrote {path}" for path in self._outputs()),
        ]
        self.show(
            result.as_json(), *lines, *([f"the video is {NO_ENCODER}"] if result.codec == "mpeg4" else [])
        )

    def _options(self) -> "SegmentOptions":
        if self.trajectory is not None and not self.moving:
            raise UserError("--trajectory needs --moving")
        if self.sheet is not None:
            require_suffix(self.sheet, "a sheet", ".jpg", ".jpeg")
        if self.what is None and self.tracks is None:
            raise UserError("name a video, or tracks with --tracks FILE")
        if not self._outputs() and not self.json_:
            self.out = Path(f"{_stem(self.what or str(self.tracks))}-segmented.mp4")
        for path in self._outputs():
            for given in (self.what, self.tracks):
                if given is not None and path.exists() and Path(given).exists() and path.samefile(given):
                    raise UserError(f"{path}: is the input")
        for folder in (self.out, self.masks):
            self.clear_frames(folder)
        read = self._given()
        if self.what is not None and ":" not in self.what:  # of a file, before the core is loaded
            from comotion_sources.cameras.opening import open_frames

            open_frames(self.what, self.rate).close()
        from comotion_experiments.labelled import SegmentOptions

        return self.call(
            SegmentOptions,
            tracker=self.tracker_config(moving=self.moving),
            fusion=self.fusion_config(),
            calibration=read_calibration(self.calibration, self.extrinsics),
            use_depth=self.depth,
            given=read,
            names=self.names(),
        )

    def _given(self) -> "Recording | None":
        """The tracks that take the place of those of our tracker."""
        if self.tracks is None:
            self.reject_flags(("fps",), "is of --tracks")
            return None
        from comotion_sources.recordings import read_recording

        self.reject_flags(_OWN_TRACKER, "is of our own tracker, whose place --tracks takes")
        if self.what is None:
            return read_recording(self.tracks, self.fps)
        self.reject_flags(("fps",), "is for --tracks without a video, which has a rate of its own")
        # The frames of the video have times; any rate will do for the tracks.
        return read_recording(self.tracks, _ANY_RATE)

    def _outputs(self) -> list[Path]:
        """The files and folders to write."""
        return [
            path for path in (self.out, self.csv, self.sheet, self.trajectory, self.masks) if path is not None
        ]


def _stem(what: str) -> str:
    name = what.removeprefix("workcell:").partition("?")[0].replace("/", "-") if ":" in what else ""
    return name or Path(what).resolve().stem
