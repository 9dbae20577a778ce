"""Pictures and samples of README, gallery and guides: ``python -m comotion_experiments.pictures docs``.

Those that ``comotion segment`` and ``comotion evaluate`` make are made by them (see the Makefile). Pictures
of the viewer, of a terminal and of the page of figures are taken by hand. No picture is reduced to a palette:
hypotheses must not share a colour. The samples are what a recording of a simulated scene would hold, for
Foxglove and for Rerun (extras `foxglove` and `view`).
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from comotion import Fusion, FusionConfig
from comotion_clients.feed import play
from comotion_clients.metrics import Score
from comotion_schemas import HypothesisUpdate, Message, ObservationBatch
from comotion_schemas.text import counted
from comotion_sources.cameras.opening import open_frames
from comotion_sources.simulator import batches, load_scene, simulate

from .inputs import Incoming
from .offline import run_offline
from .plot import new_figure
from .segment import SegmentOptions, segment

WORKCELL = "workcell:truck-tower/a?rate=10&size=640x480&duration=7"
STILL = 50
"""Frame of the workcell that is the still picture: all bodies have moved."""
SCENES = {"truck": 3.0, "truck-tower": 5.0, "shelf": 6.0, "arm": 3.0}
"""Scenes of the overview, each with the time of its picture, s."""
_AFFINITY_S = (0.3, 0.7, 3.0)
_FIRST = 10  # frame; nothing has moved before
_EVERY = 2  # frames
_MS = 200  # per image of the animation
_LIMIT = 1_000_000  # bytes
SAMPLE, _SAMPLE_S = "3d_5", 6.0
NOON_NS = 1_767_268_800_000_000_000
"""Noon of a day: a viewer writes the date instead of the time where a scene begins at midnight."""


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


def _workcell(moving: Path) -> None:
    """Write the animation of a segmented video beside what its camera saw, and beside it a still picture."""
    with tempfile.TemporaryDirectory() as temporary:
        segment(WORKCELL, SegmentOptions(out=Path(temporary)))
        coloured = [cv2.imread(str(path)) for path in sorted(Path(temporary).glob("*.png"))]
    with closing(open_frames(WORKCELL, None)) as camera:
        raw = [frame.image for frame in camera]
    pairs = zip(raw, coloured, strict=True)
    images = [np.hstack((seen, drawn)) for seen, drawn in pairs if drawn is not None]
    still = moving.with_name("hypotheses.jpg")
    cv2.imwrite(str(still), images[min(STILL, len(images) - 1)], [cv2.IMWRITE_JPEG_QUALITY, 90])
    # It begins where all bodies have moved, for who sees one picture of it.
    frames = [*images[STILL::_EVERY], *images[_FIRST:STILL:_EVERY]] or images
    for quality in (80, 65, 50, 35):
        animation = cv2.Animation()
        animation.frames, animation.durations = frames, [_MS] * len(frames)
        cv2.imwriteanimation(str(moving), animation, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if moving.stat().st_size < _LIMIT:
            break


def _played() -> list[tuple[int, Message]]:
    """What a recorder would have received of the sample: (time in ns, message) in order."""
    messages: list[tuple[int, Message]] = []

    def noted() -> Iterator[Incoming]:
        newest_ns = NOON_NS
        for message in batches(simulate(load_scene(SAMPLE)), epoch_ns=NOON_NS):
            newest_ns = message.stamp_ns if isinstance(message, ObservationBatch) else newest_ns
            messages.append((newest_ns, message))
            yield message

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        messages.append((update.published_ns, update))

    run_offline(noted(), FusionConfig(), duration=_SAMPLE_S, on_update=on_update)
    return messages


def _foxglove(path: Path) -> None:
    import foxglove

    from comotion_clients.foxglove.scene import FoxgloveScene

    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        play(FoxgloveScene(context), _played())


def _rerun(path: Path) -> None:
    from comotion_clients.viewing.picture import ScenePicture
    from comotion_clients.viewing.sink import RerunSink

    with RerunSink(file=path) as sink:
        play(ScenePicture(SAMPLE, sink=sink), _played())


PICTURES: dict[str, Callable[[Path], object]] = {
    "images/hero.webp": _workcell,
    "images/workcell.jpg": _scenes,
    "images/affinity.png": _affinity,
    f"samples/{SAMPLE}.mcap": _foxglove,
    f"samples/{SAMPLE}.rrd": _rerun,
}
"""What draws each picture or sample to a path; those of the workcell need MuJoCo (extra ``sim3d``)."""


def main() -> None:
    """Make pictures and samples in a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=PICTURES, help="name of one picture")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for name in [arguments.only] if arguments.only else PICTURES:
        path = arguments.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        PICTURES[name](path)


if __name__ == "__main__":
    main()
