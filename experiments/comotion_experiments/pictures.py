"""The pictures of README, gallery and guides: ``python -m comotion_experiments.pictures FOLDER``.

The workcell is rendered and segmented as ``comotion segment`` does it; scenes are plotted as ``comotion
evaluate --plot`` does it. Viewer, terminal and pages are looked at by the browser that ``COMOTION_CHROMIUM``
names; without one these pictures stay as they are. No picture is reduced to a palette: hypotheses must not
share a colour.
"""

import argparse
import logging
import os
import tempfile
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion_schemas import ObservationBatch
from comotion_schemas.text import counted
from comotion_sources.cameras.opening import open_frames
from comotion_sources.simulator import batches, load_scene, simulate

from . import screens
from .evaluate import evaluate_inputs
from .inputs import find_inputs
from .plot import new_figure
from .segment import SegmentOptions, segment

WORKCELL = "workcell:truck-tower/a?rate=10&size=640x480&duration=7"
STILL = 50
"""Frame of the workcell that is the still picture: all bodies have moved."""
SCENES = {"truck": 3.0, "truck-tower": 5.0, "shelf": 6.0, "arm": 3.0}
"""Scenes of the overview, each with the time of its picture, s."""
PLOTS = {"3d_5.png": "sim:3d_5", "fig4_4.png": "sim:fig4_4"}
SHEETS = {
    f"sheet-{scene}.jpg": f"workcell:{scene}/{camera}?rate=15&size=640x480"
    for scene, camera in (("truck", "a"), ("truck-tower", "b"), ("shelf", "a"), ("arm", "b"))
}
"""Whole videos of a plain camera, each on a page."""
_AFFINITY_S = (0.3, 0.7, 3.0)
_FIRST = 10  # frame; nothing has moved before
_EVERY = 2  # frames
_MS = 200  # per image of the animation
_LIMIT = 1_000_000  # bytes
_log = logging.getLogger(__name__)


def make(folder: Path, only: str | None = None) -> list[Path]:
    """Make the pictures, or one of them by name; returns their paths.

    Raises
    ------
    comotion_sources.cameras.types.CameraError
        If MuJoCo is not installed (extra ``sim3d``).
    """
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    if only in {None, "hero.webp", "hypotheses.jpg"}:
        made += _workcell(folder)
    for name, scene in PLOTS.items():
        if only in {None, name}:
            evaluate_inputs(find_inputs([scene]), FusionConfig(), plot=folder / name)
            made.append(folder / name)
    for name, video in SHEETS.items():
        if only in {None, name}:
            segment(video, SegmentOptions(sheet=folder / name, use_depth=False))
            made.append(folder / name)
    if only in {None, "workcell.jpg"}:
        made.append(_scenes(folder / "workcell.jpg"))
    if only in {None, "affinity.png"}:
        made.append(_affinity(folder / "affinity.png"))
    return made + _screens(folder, only)


def _screens(folder: Path, only: str | None) -> list[Path]:
    wanted = [name for name in screens.SCREENS if only in {None, name}]
    if wanted and not os.environ.get(screens.CHROMIUM):
        _log.warning("no browser in %s: %s stay as they are", screens.CHROMIUM, ", ".join(wanted))
        return []
    return [screens.take(folder, name) for name in wanted]


def _scenes(path: Path) -> Path:
    """Every scene, seen by camera a above and by camera b below."""
    rows = []
    for camera in "ab":
        seen = []
        for scene, seconds in SCENES.items():
            frames = open_frames(
                f"workcell:{scene}/{camera}?size=320x240&rate=1&duration={seconds + 1}", None
            )
            *_, last = frames
            frames.close()
            seen.append(last.image)
        rows.append(np.hstack(seen))
    cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 85])
    return path


def _affinity(path: Path) -> Path:
    """The affinities of a scene with a background and four bodies, soon and later."""
    figure = new_figure(10, 3.6)
    axes = figure.subplots(1, 3)
    fusion, due = Fusion(FusionConfig()), list(zip(axes, _AFFINITY_S, strict=True))
    for message in batches(simulate(load_scene("3d_5"))):
        if not isinstance(message, ObservationBatch) or not due:
            continue
        fusion.ingest(message)
        if message.stamp_ns >= due[0][1] * 1e9:
            axis, at = due.pop(0)
            update = fusion.update(message.stamp_ns)
            image = axis.imshow(fusion.affinity("world").matrix, vmin=0, vmax=1, cmap="cividis")
            axis.set_title(f"t = {at} s, {counted(len(update.hypotheses), 'hypothesis')}")
            axis.set(xlabel="feature", ylabel="feature")
    figure.colorbar(image, ax=axes, label="affinity", shrink=0.7)
    figure.savefig(path, dpi=90)
    return path


def _workcell(folder: Path) -> list[Path]:
    with tempfile.TemporaryDirectory() as temporary:
        segment(WORKCELL, SegmentOptions(out=Path(temporary)))
        read = [cv2.imread(str(path)) for path in sorted(Path(temporary).glob("*.png"))]
    images = [np.asarray(image, np.uint8) for image in read if image is not None]
    with closing(open_frames(WORKCELL, None)) as camera:
        raw = [frame.image for frame in camera]
    pairs = [np.hstack((seen, coloured)) for seen, coloured in zip(raw, images, strict=True)]
    return from_frames(folder, [np.asarray(pair, np.uint8) for pair in pairs])


def from_frames(folder: Path, images: list[NDArray[np.uint8]]) -> list[Path]:
    """Write the animation and the still picture of a segmented video, uint8 [H, W, 3] each."""
    still, moving = folder / "hypotheses.jpg", folder / "hero.webp"
    cv2.imwrite(str(still), images[min(STILL, len(images) - 1)], [cv2.IMWRITE_JPEG_QUALITY, 90])
    # It begins where all bodies have moved, for who sees one picture of it.
    frames = [*images[STILL::_EVERY], *images[_FIRST:STILL:_EVERY]] or images
    for quality in (80, 65, 50, 35):
        animation = cv2.Animation()
        animation.frames, animation.durations = frames, [_MS] * len(frames)
        cv2.imwriteanimation(str(moving), animation, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if moving.stat().st_size < _LIMIT:
            break
    return [still, moving]


def main() -> None:
    """Make the pictures in a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", help="name of one picture")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    cv2.setNumThreads(1)
    for path in make(arguments.folder, arguments.only):
        _log.info("%s: %d kB", path, path.stat().st_size // 1000)


if __name__ == "__main__":
    main()
