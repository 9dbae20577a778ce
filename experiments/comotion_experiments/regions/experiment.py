"""Scores how well dense regions cover the true objects of workcell scenes.

The regions of each hypothesis are scored once a second against the truth of every pixel. Beside the
watershed: the nearest labelled feature, and both with the true object of every feature as its label.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion_clients.regions import intersection_over_union, nearest, regions
from comotion_sources.klt import Tracks
from comotion_sources.workcell import Scene

from ..labelled import Labelled, SegmentOptions, labelled_frames
from ..processes import Progress, quiet

SCENES = ("shelf", "truck", "arm")
METHODS = ("watershed", "nearest feature", "watershed, true labels", "nearest feature, true labels")
SIZE, RATE_HZ = (640, 480), 15.0
# s between scored frames; m and rad: a body that has moved less is no object yet.
_EVERY_S = 1.0
_MOVED_M, _MOVED_RAD = 0.02, 0.1
# Objects with fewer pixels are left out.
_LEAST_PIXELS = 200
Objects = NDArray[np.int32]


@dataclass
class Scored:
    """One seed of one scene: IoU of every scored object and frame by method, of bodies and background."""

    scene: str
    seed: int
    bodies: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in METHODS})
    background: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in METHODS})

    def mean(self, method: str) -> float:
        """Mean IoU of the bodies that have moved, over bodies and frames."""
        return float(np.mean(self.bodies[method])) if self.bodies[method] else np.nan


def run_experiment(
    scenes: Sequence[str],
    seeds: Sequence[int],
    config: FusionConfig,
    *,
    duration: float | None = None,
    progress: Progress = quiet,
) -> list[Scored]:
    """Score every seed of every scene; `duration` s, one period by default."""
    found = []
    for scene in scenes:
        for seed in seeds:
            progress(f"{scene}, seed {seed}")
            found.append(run_seed(scene, seed, config, duration))
    return found


def run_seed(name: str, seed: int, config: FusionConfig, duration: float | None = None) -> Scored:
    """Render, track and group camera A of one scene, and score its regions."""
    scene, found = Scene.named(name, seed), Scored(name, seed)
    seconds = duration or scene.period
    where = f"workcell:{name}/a?size={SIZE[0]}x{SIZE[1]}&rate={RATE_HZ:g}&seed={seed}&duration={seconds:g}"
    truth = _Truth(scene)
    due = _EVERY_S
    for one in labelled_frames(where, SegmentOptions(fusion=config)):
        t = one.frame.stamp_ns * 1e-9
        objects = truth.at(t, one.frame.objects)
        if t >= due - 1e-6:
            due += _EVERY_S
            for method, labels in _labels(one, objects):
                _score(found, method, labels, objects)
    return found


class _Truth:
    """The object of every pixel, where what has not moved yet is background."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._data = scene, scene.new_data()
        self._first = self._data.xpos.copy(), self._data.xmat.copy()
        self._moved: set[int] = set()

    def at(self, t: float, objects: Objects | None) -> Objects:
        assert objects is not None  # noqa: S101 - a camera of the workcell always knows them
        self._scene.place(self._data, self._scene.configuration(t))
        shift = np.linalg.norm(self._data.xpos - self._first[0], axis=1)
        # The Frobenius norm of a difference of rotations is √2 times its chord.
        turn = np.linalg.norm(self._data.xmat - self._first[1], axis=1) / np.sqrt(2)
        moved = (shift > _MOVED_M) | (turn > _MOVED_RAD)
        self._moved |= set(self._scene.body_objects[moved].tolist())
        rests = ~np.isin(objects, [*self._moved, -1])
        return np.where(rests, np.int32(0), objects)


def _labels(one: Labelled, objects: Objects) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """The labels of every pixel, by method."""
    pixels, image = one.tracks.pixels, one.frame.image
    true = _objects_of(one.tracks, objects)
    for suffix, labels in (("", one.hypotheses), (", true labels", true)):
        yield f"watershed{suffix}", regions(image, pixels, labels)
        yield f"nearest feature{suffix}", nearest(objects.shape, pixels, labels)


def _objects_of(tracks: Tracks, objects: Objects) -> NDArray[np.int64]:
    """The true object under each feature, int64 [N]."""
    height, width = objects.shape
    x, y = np.rint(tracks.pixels).astype(np.int64).T
    return np.asarray(objects[y.clip(0, height - 1), x.clip(0, width - 1)], np.int64)


def _score(found: Scored, method: str, labels: NDArray[np.int64], objects: Objects) -> None:
    counts = np.bincount(objects[objects >= 0])
    for number, score in intersection_over_union(labels, objects).items():
        if counts[number] >= _LEAST_PIXELS:
            (found.bodies if number else found.background)[method].append(score)
