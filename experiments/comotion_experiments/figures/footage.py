"""Films scenes of the workcell and keeps their tracked features on disk; renders still images."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import msgpack
import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_sources import klt, workcell
from comotion_sources.klt.config import TrackerConfig
from comotion_sources.workcell import Scene, Viewpoint
from comotion_sources.workcell.atlas import build_atlas
from comotion_sources.workcell.camera import CameraSpec

from ..inputs import Message
from ..rendered import filmed
from .study import Study

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
    said: str  # about telling them apart, by the thesis


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
    messages = [message for image in filmed(camera, _SOURCE, tracker) for message in image.messages]
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_bytes(msgpack.packb([encode(message) for message in messages]))
        partial.replace(path)
    return messages


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
        atlas = build_atlas(self._scene.model, seed)
        # Without image noise, which would take 90 % of the size of a PNG.
        self._view = Viewpoint(self._scene, CAMERA, PICTURE, atlas, grain=0.0)
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
