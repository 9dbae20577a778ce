"""Speed and truth of the KLT tracker on one core: frames per second, drift, features that wander off.

    python tests/benchmarks/klt.py                    # rendered scenes of the workcell (extra sim3d)
    python tests/benchmarks/klt.py drawer.avi ...     # any videos: frames per second only
    python tests/benchmarks/klt.py --set fb_absolute=0.5 --scene shelf

Time is the processor's, so that other processes on the machine do not count.
"""

import argparse
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_sources.cameras import Frame, open_frames
from comotion_sources.klt import Tracker, TrackerConfig, Tracks

HORIZON = 30  # frames: one second


@dataclass
class Stopwatch:
    """Processor time of some frames."""

    frames: int = 0
    seconds: float = 0.0

    def step(self, tracker: Tracker, frame: Frame) -> Tracks:
        began = time.process_time()
        tracks = tracker.step(frame)
        self.seconds += time.process_time() - began
        self.frames += 1
        return tracks

    @property
    def rate(self) -> float:
        return self.frames / self.seconds


@dataclass
class Birth:
    frame: int
    object: int
    local: NDArray[np.float64]


@dataclass
class Truth:
    """What became of the features one second after they were born."""

    on: int = 0
    off: int = 0
    drift: list[float] = field(default_factory=list)
    births: dict[int, Birth] = field(default_factory=dict)


def main() -> None:
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("videos", nargs="*")
    parser.add_argument("--scene", action="append", help="workcell scene; default: all four")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="tracker parameter")
    given = parser.parse_args()
    config = TrackerConfig(**dict(text.split("=", 1) for text in given.set))
    if given.videos:
        for video in given.videos:
            run_video(video, config)
        return
    print(
        f"{'scene':<12} {'depth':<6} {'frames/s':>8} {'features':>8} "
        f"{'on body':>8} {'drift mm':>8} {'p90 mm':>8}"
    )
    for scene in given.scene or ("truck", "truck-tower", "shelf", "arm"):
        for depth in (True, False):
            run_scene(scene, depth, given.seconds, config)


def run_video(video: str, config: TrackerConfig) -> None:
    watch, tracker = Stopwatch(), Tracker(config)
    counts = [len(watch.step(tracker, frame).ids) for frame in open_frames(video)]
    print(f"{video}: {watch.rate:.0f} frames/s, {np.mean(counts):.0f} features, {watch.frames} frames")


def run_scene(name: str, depth: bool, seconds: float, config: TrackerConfig) -> None:
    from comotion_sources.workcell.scene import Scene
    from comotion_sources.workcell.viewpoint import Viewpoint

    scene = Scene.named(name)
    view = Viewpoint(scene, "a")
    data = scene.new_data()
    tracker = Tracker(config, view.intrinsics if depth else None)
    watch, truth, counts = Stopwatch(), Truth(), []
    frames = round(seconds * 30)
    for k in range(frames):
        stamp = round((1.0 + k / 30) * 1e9)
        configuration = scene.configuration(stamp * 1e-9)
        frame = view.frame(configuration, stamp)
        tracks = watch.step(tracker, frame if depth else Frame(stamp, frame.image))
        counts.append(len(tracks.ids))
        scene.place(data, configuration)
        judge(truth, tracks, frame, k, frames, view.extrinsics.apply, data, scene.body_objects)
    on = 100 * truth.on / max(1, truth.on + truth.off)
    drift = 1e3 * np.array(truth.drift or [np.nan])
    kind = "yes" if depth else "no"
    print(
        f"{name:<12} {kind:<6} {watch.rate:8.0f} {np.mean(counts):8.0f} {on:7.1f}% "
        f"{np.median(drift):8.1f} {np.quantile(drift, 0.9):8.1f}"
    )


def judge(truth, tracks, frame, k, frames, to_world, data, body_objects) -> None:
    """Compare the object under each feature with the one it was born on, and its place on the body."""
    column, row = np.rint(tracks.pixels).astype(int).T
    under = frame.objects[row, column]
    points = None if tracks.points is None else to_world(tracks.points)
    for i in np.flatnonzero(under >= 0):  # outlines, where a feature may be either's, are not scored
        feature, here = int(tracks.ids[i]), int(under[i])
        body = int(np.flatnonzero(body_objects == here)[0])
        if tracks.born[i] and k + HORIZON < frames:
            truth.births[feature] = Birth(k, here, local(data, body, points, i))
        birth = truth.births.get(feature)
        if birth is None or k - birth.frame != HORIZON:
            continue
        truth.on += here == birth.object
        truth.off += here != birth.object
        if here == birth.object:
            moved = local(data, body, points, i) - birth.local
            if np.isfinite(moved).all():
                truth.drift.append(float(np.linalg.norm(moved)))


def local(data, body: int, points, i: int) -> NDArray[np.float64]:
    """A feature's point in the frame of a body."""
    if points is None:
        return np.full(3, np.nan)
    return data.xmat[body].reshape(3, 3).T @ (points[i] - data.xpos[body])


if __name__ == "__main__":
    main()
