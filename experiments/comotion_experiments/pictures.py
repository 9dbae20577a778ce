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
_HERO = ("hero.webp", "hypotheses.jpg")
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
    comotion_sources.cameras.types.InputError
        If MuJoCo is not installed (extra ``sim3d``).
    """
    folder.mkdir(parents=True, exist_ok=True)
    if only in {None, *_HERO}:
        _workcell(folder)
    for name, scene in PLOTS.items():
        if only in {None, name}:
            evaluate_inputs(find_inputs([scene]), FusionConfig(), plot=folder / name)
    for name, video in SHEETS.items():
        if only in {None, name}:
            segment(video, SegmentOptions(sheet=folder / name, use_depth=False))
    for name, draw in {"workcell.jpg": _scenes, "affinity.png": _affinity}.items():
        if only in {None, name}:
            draw(folder / name)
    on_screens = [name for name in screens.SCREENS if only in {None, name}]
    if on_screens and not os.environ.get(screens.CHROMIUM):
        _log.warning("no browser in %s: %s stay as they are", screens.CHROMIUM, ", ".join(on_screens))
        on_screens = []
    for name in on_screens:
        screens.take(folder, name)
    made = [*_HERO, *PLOTS, *SHEETS, "workcell.jpg", "affinity.png", *on_screens]
    return [folder / name for name in made if only in {None, name}]


def _scenes(path: Path) -> None:
    """Every scene, seen by camera a above and by camera b below."""
    rows = []
    for camera in "ab":
        seen = []
        for scene, seconds in SCENES.items():
            video = f"workcell:{scene}/{camera}?size=320x240&rate=1&duration={seconds + 1}"
            with closing(open_frames(video, None)) as frames:
                *_, last = frames
            seen.append(last.image)
        rows.append(np.hstack(seen))
    cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 85])


def _affinity(path: Path) -> None:
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


def _workcell(folder: Path) -> None:
    """Write the animation and the still picture of a segmented video beside what its camera saw."""
    with tempfile.TemporaryDirectory() as temporary:
        segment(WORKCELL, SegmentOptions(out=Path(temporary)))
        coloured = [cv2.imread(str(path)) for path in sorted(Path(temporary).glob("*.png"))]
    with closing(open_frames(WORKCELL, None)) as camera:
        raw = [frame.image for frame in camera]
    pairs = zip(raw, coloured, strict=True)
    images = [np.hstack((seen, drawn)) for seen, drawn in pairs if drawn is not None]
    moving, still = (folder / name for name in _HERO)
    cv2.imwrite(str(still), images[min(STILL, len(images) - 1)], [cv2.IMWRITE_JPEG_QUALITY, 90])
    # It begins where all bodies have moved, for who sees one picture of it.
    frames = [*images[STILL::_EVERY], *images[_FIRST:STILL:_EVERY]] or images
    for quality in (80, 65, 50, 35):
        animation = cv2.Animation()
        animation.frames, animation.durations = frames, [_MS] * len(frames)
        cv2.imwriteanimation(str(moving), animation, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if moving.stat().st_size < _LIMIT:
            break


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
