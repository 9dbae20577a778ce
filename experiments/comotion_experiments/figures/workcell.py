"""Figures 4.6 to 4.11: features of a KLT tracker on three scenes of the workcell.

Scenes are filmed once: their tracked features are kept on disk.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_sources import klt, workcell
from comotion_sources.klt.config import TrackerConfig
from comotion_sources.klt.observer import Observer, choose_space
from comotion_sources.klt.tracker import Tracker
from comotion_sources.streams import OFFLINE_SESSION
from comotion_sources.workcell import Scene, Viewpoint
from comotion_sources.workcell.camera import CameraSpec, WorkcellCamera

from ..inputs import Message
from ..offline import thesis
from ..tables import spread
from . import panels
from .runs import SceneRuns, View, ViewRequest, main_hypothesis
from .study import (
    DEFAULT,
    Drawn,
    Simulated,
    Study,
    best,
    right_rows,
    row_of,
    rows_of_each,
    run_parameters,
)

CAMERA = "a"
_SOURCE = "klt-a"
SECONDS = 18.0
PICTURE = (320, 240)
# Packages that tracked features depend on, beside the set-up.
_PRODUCERS = (klt, workcell)


@dataclass(frozen=True)
class Shot:
    """One scene of the thesis, by its name here."""

    scene: str
    respawn_every: int  # frames between two looks for new features
    times: tuple[float, ...]  # moments to show, s
    apart: tuple[str, str]  # two objects
    claim: str  # of the thesis, on their separation


def film_setup(study: Study, shot: Shot, seed: int = 0) -> tuple[CameraSpec, TrackerConfig]:
    """Choose the set-up of the thesis: every n-th frame new features at the 100 best corners."""
    size, features = ((320, 240), 100) if study.options.quick else ((480, 360), 200)
    camera = CameraSpec(scene=shot.scene, camera=CAMERA, size=size, rate=30.0, seed=seed, duration=SECONDS)
    return camera, TrackerConfig(max_features=features, spawn_limit=100, respawn_every=shot.respawn_every)


def filmed_messages(study: Study, shot: Shot, seed: int) -> list[Message]:
    """Read the messages of a scene from the cache, or film it and keep them there."""
    camera, tracker = film_setup(study, shot, seed)
    name, cache = f"film-{shot.scene}-{seed}-{_fingerprint(camera, tracker)}.msgpack", study.options.cache
    path = None if cache is None else cache / name
    if path is not None and path.is_file():
        kept = (decode(raw) for raw in msgpack.unpackb(path.read_bytes()))
        return [message for message in kept if isinstance(message, TruthBatch | ObservationBatch)]
    frames = round(SECONDS * camera.rate)
    study.note(f"{shot.scene}, seed {seed}: rendering and tracking {frames} frames")
    messages = list(_film(camera, tracker))
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_bytes(msgpack.packb([encode(message) for message in messages]))
        partial.replace(path)
    return messages


def _film(spec: CameraSpec, config: TrackerConfig) -> Iterator[Message]:
    """Render a scene with depth, and track features in it; the same for the same arguments."""
    camera = WorkcellCamera(spec)
    space = choose_space(_SOURCE, has_depth=True, intrinsics=camera.intrinsics, extrinsics=camera.extrinsics)
    observer = Observer(space, space.builder(_SOURCE, OFFLINE_SESSION), camera.objects)
    tracker = Tracker(config, camera.intrinsics)
    for frame in camera:
        yield from observer.messages(tracker.step(frame), frame)


def _fingerprint(*how: object) -> str:
    """Digest of the set-up, and of all code and scenes that the messages depend on."""
    digest = hashlib.sha256(repr(how).encode())
    folders = [Path(str(package.__file__)).parent for package in _PRODUCERS]
    for path in sorted(path for folder in folders for path in folder.rglob("*.[px][ym]*")):
        if path.suffix in {".py", ".xml"}:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


class Stills:
    """Renders still images of a scene and seed of the workcell, and projects points into them."""

    def __init__(self, scene: str, seed: int) -> None:
        self._scene = Scene(scene, seed)
        # Without image noise, which would take 90 % of the size of a PNG.
        self._view = Viewpoint(self._scene, CAMERA, PICTURE, grain=0.0)
        self._into_camera = self._view.extrinsics.inverse()

    @property
    def names(self) -> dict[int, str]:
        """Names of the true objects by number."""
        return dict(self._scene.objects)

    def picture(self, t: float) -> NDArray[np.uint8]:
        """Render the RGB image uint8 [H, W, 3] at a time in seconds."""
        frame = self._view.frame(self._scene.configuration(t), round(t * 1e9))
        return np.ascontiguousarray(frame.image[..., ::-1])

    def pixels(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Project points float32 [N, 3] of the world to pixels float32 [N, 2]."""
        if not len(points):
            return np.zeros((0, 2), np.float32)
        inside = self._into_camera.apply(points.astype(np.float64))
        return np.asarray(self._view.intrinsics.project(inside), np.float32)


PERIOD = 1 / 3
SWITCHES = (0.0025, 0.005, 0.01, 0.02, 0.04)
_START_S = 4.0
_SHADE = 8
# When the shelf's door turns (see its scene).
_OPENING_S, _CLOSING_S = (3.0, 5.0), (6.4, 8.8)


TRUCK = Shot("truck", 15, (4.0, 6.0, 8.0, 14.0), ("truck", "gripper"), "different, if observed for long")
TOWER = Shot("truck-tower", 30, (4.0, 6.0, 8.0, 14.0), ("truck", "tower"), "nicely separated")
SHELF = Shot("shelf", 15, (10 / 3, 16 / 3, 22 / 3, 37 / 3), ("door", "drawer"), "a hypothesis each")


def _takes(study: Study, shot: Shot) -> dict[str, SceneRuns]:
    configs = {f"σ = {s:g} m": thesis(s) for s in SWITCHES}
    how = Simulated(shot.scene, configs, PERIOD, ViewRequest(shot.times, trail=0.7))
    return study.takes(how, partial(filmed_messages, study, shot), study.options.workcell_seeds)


def pictures(shot: Shot) -> Callable[[Study], Drawn]:
    """Figures 4.6 to 4.8: moments of a scene, features coloured by hypothesis."""

    def draw(study: Study) -> Drawn:
        takes = _takes(study, shot)
        label = best(takes)
        shown = {f"thesis method, {label}": takes[label], DEFAULT: takes[DEFAULT]}
        stills = Stills(shot.scene, study.options.workcell_seeds[0])
        figure = panels.new_figure(3.25 * len(shot.times), 7.9)
        rows = figure.subplots(3, len(shot.times))
        for row, (label, take) in zip(rows, shown.items(), strict=False):
            styles = panels.Styles(take.seeds[0].names, take.seeds[0].votes())
            for axes, view in zip(row, take.seeds[0].views, strict=True):
                _picture(axes, stills, view, styles)
            row[0].set_ylabel(label, fontsize=11, fontweight="bold")
        _truth(rows[2], stills, shown[DEFAULT])
        panels.object_legend(figure, stills.names)
        numbers = right_rows(shown, shot.times, "-")
        name, other = shot.apart
        what = f"{name} and {other} in different hypotheses, from t = {_START_S:g} s on"
        numbers.append(row_of(what, shot.claim, shown, partial(_apart, name=name, other=other)))
        if shot is SHELF:
            numbers.append(row_of("the door's hypothesis, closing", "another than opening", shown, _door))
        return Drawn(figure, numbers, _parameters(study, shot, drawn=True))

    return draw


def curves(shot: Shot) -> Callable[[Study], Drawn]:
    """Figures 4.9 to 4.11: NMI over time for several σ and the default method."""

    def draw(study: Study) -> Drawn:
        takes = _takes(study, shot)
        seeds = study.options.workcell_seeds
        figure = panels.switch_curves(takes, seeds, 4.8, duration=SECONDS, columns=2)
        made_with = _parameters(study, shot, drawn=False)
        return Drawn(figure, rows_of_each("mean NMI", takes, "-" * len(SWITCHES)), made_with, takes)

    return draw


def _picture(axes: Any, stills: Stills, view: View, styles: panels.Styles) -> None:
    # Paler than it was, so that the features stand out; in fewer shades, so that the file is small.
    image = stills.picture(view.t).astype(np.float32)
    pale = 0.45 * image + 0.2 * image.mean(axis=2, keepdims=True) + 0.35 * 255
    shades = (pale / _SHADE).round() * _SHADE
    extent = (-0.5, PICTURE[0] - 0.5, PICTURE[1] - 0.5, -0.5)
    axes.imshow(shades.clip(0, 255).astype(np.uint8), extent=extent, interpolation="nearest")
    flat = replace(
        view,
        moment=replace(view.moment, positions=stills.pixels(view.moment.positions)),
        trails=[stills.pixels(trail) for trail in view.trails],
    )
    panels.draw_tracks(axes, flat, styles, size=4.0, edge=0.5)
    axes.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    axes.set_title(f"t = {view.t:.3g} s", fontsize=10)


def _truth(row: Any, stills: Stills, take: SceneRuns) -> None:
    """Draw the true objects of the same features; those that are not scored are undetermined here."""
    first = take.seeds[0]
    styles = panels.Styles(first.names, {(number, number): 1 for number in first.names})
    for axes, view in zip(row, first.views, strict=True):
        scored = view.moment.objects >= 0
        moment = view.moment.of(scored)
        moment = replace(moment, hypotheses=moment.objects)
        trails = [trail for trail, shown in zip(view.trails, scored, strict=True) if shown]
        _picture(axes, stills, replace(view, moment=moment, trails=trails), styles)
    row[0].set_ylabel("truth", fontsize=11, fontweight="bold")


def _apart(take: SceneRuns, name: str, other: str) -> str:
    """Share of updates in which most of two objects' features are in different hypotheses."""
    shares = []
    for seed in take.seeds:
        first, second = seed.main_of(name), seed.main_of(other)
        both = (seed.run.seconds >= _START_S) & (first >= 0) & (second >= 0)
        shares.append(100 * np.mean(first[both] != second[both]) if both.any() else np.nan)
    return f"{spread(shares, 0)} % of updates"


def _door(take: SceneRuns) -> str:
    """Whether the door has the same hypothesis while it closes as while it opened."""
    same = 0
    for seed in take.seeds:
        ids = seed.main_of("door")
        t = seed.run.seconds
        assigned = (ids[(ids >= 0) & (t >= a) & (t < b)] for a, b in (_OPENING_S, _CLOSING_S))
        opening, closing = map(main_hypothesis, assigned)
        same += opening == closing
    return f"the same in {same} of {len(take.seeds)} seeds"


def _parameters(study: Study, shot: Shot, *, drawn: bool) -> dict[str, str]:
    camera, tracker = film_setup(study, shot)
    made_with = {
        "scene": f"workcell:{shot.scene}, camera a, {camera.size[0]}x{camera.size[1]} at {camera.rate:g} Hz",
        "tracker": f"new features every {tracker.respawn_every} frames at the {tracker.spawn_limit} "
        f"best corners, at most {tracker.max_features} at once",
    }
    switches = f"σ = {', '.join(f'{s:g}' for s in SWITCHES)} m, equal weights"
    return made_with | run_parameters(switches, PERIOD, study.options.workcell_seeds, drawn=drawn)
