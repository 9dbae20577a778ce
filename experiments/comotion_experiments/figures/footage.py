"""Workcell footage: scene and seed -> tracked features, kept on disk, and still images."""

import hashlib
import importlib
from dataclasses import dataclass
from pathlib import Path

import msgpack
import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_sources.klt import TrackerConfig
from comotion_sources.workcell import Scene, Viewpoint
from comotion_sources.workcell.atlas import build_atlas
from comotion_sources.workcell.camera import CameraSpec
from comotion_sources.workcell.scene import scene_folder
from comotion_sources.workcell.sensor import SensorNoise

from ..inputs import Message
from ..rendered import filmed
from .runs import SceneRuns, ViewRequest, run_seed
from .study import Study, describe

CAMERA = "a"
_SOURCE = "klt-a"
_SPAWN_LIMIT = 100
PERIOD = 1 / 3
PICTURE = (320, 240)
# What tracked features depend on, beside the set-up and the files of the scenes.
_PRODUCERS = (
    *(f"klt.{name}" for name in ("config", "corners", "depth", "flow", "observer", "template", "tracker")),
    *(
        f"workcell.{name}"
        for name in ("atlas", "drawing", "render", "scene", "sensor", "shapes", "textures", "viewpoint")
    ),
)


@dataclass(frozen=True)
class FilmSetup:
    """Image size in px, rate in Hz, duration in s, and parameters of the tracker."""

    size: tuple[int, int]
    rate: float
    seconds: float
    tracker: TrackerConfig


def film_setup(study: Study, respawn_every: int) -> FilmSetup:
    """Choose the set-up of the thesis: every n-th frame new features at the 100 best corners."""
    size, features = ((320, 240), 100) if study.options.quick else ((480, 360), 200)
    tracker = TrackerConfig(max_features=features, spawn_limit=_SPAWN_LIMIT, respawn_every=respawn_every)
    return FilmSetup(size, 30.0, 18.0, tracker)


def takes_of(
    study: Study, scene: str, respawn_every: int, config: FusionConfig, times: tuple[float, ...]
) -> SceneRuns:
    """Run all seeds of a workcell scene."""

    def make() -> SceneRuns:
        close = ViewRequest(times, trail=0.7)
        runs = []
        for seed in study.options.workcell_seeds:
            messages = _messages(study, scene, seed, respawn_every)
            study.note(f"{scene}, {describe(config)}, seed {seed}")
            runs.append(run_seed(messages, config, PERIOD, close))
        return SceneRuns(runs)

    return study.once((scene, respawn_every, config.model_dump_json(), times), make)


def _messages(study: Study, name: str, seed: int, respawn_every: int) -> list[Message]:
    """Read the messages of a scene from the cache, or film it and keep them there."""
    how, cache = film_setup(study, respawn_every), study.options.cache
    path = None if cache is None else cache / f"film-{name}-{seed}-{_fingerprint(how)}.msgpack"
    if path is not None and path.is_file():
        kept = (decode(raw) for raw in msgpack.unpackb(path.read_bytes()))
        return [message for message in kept if isinstance(message, TruthBatch | ObservationBatch)]
    study.note(f"{name}, seed {seed}: rendering and tracking {round(how.seconds * how.rate)} frames")
    spec = CameraSpec(
        scene=name, camera=CAMERA, size=how.size, rate=how.rate, seed=seed, duration=how.seconds
    )
    messages = [message for image in filmed(spec, _SOURCE, how.tracker) for message in image.messages]
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_bytes(msgpack.packb([encode(message) for message in messages]))
        partial.replace(path)
    return messages


def _fingerprint(how: FilmSetup) -> str:
    """Digest of the set-up, and of all code and scenes that the messages depend on."""
    digest = hashlib.sha256(repr(how).encode())
    modules = [importlib.import_module(f"comotion_sources.{name}").__file__ for name in _PRODUCERS]
    for path in (*map(Path, filter(None, modules)), *sorted(scene_folder().glob("*.xml"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


class Stills:
    """Renders still images of a scene, and projects points into them.

    Parameters
    ----------
    scene, seed
        Scene and seed of the workcell.
    """

    def __init__(self, scene: str, seed: int) -> None:
        self._scene = Scene.named(scene, seed)
        atlas = build_atlas(self._scene.model, seed)
        # Without image noise, which would take 90 % of the size of a PNG.
        self._view = Viewpoint(self._scene, CAMERA, PICTURE, SensorNoise(image=0.0), atlas)
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
