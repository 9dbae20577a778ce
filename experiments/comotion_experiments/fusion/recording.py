"""Renders and tracks a scene: scene and seed -> messages of all sources, cached on disk."""

import hashlib
import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import msgpack
import numpy as np

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_schemas.errors import KnownError
from comotion_sources.frames import MessageBuilder
from comotion_sources.klt import Tracker, TrackerConfig
from comotion_sources.klt.observer import CameraSpace, Observer, choose_space
from comotion_sources.proprioception import JointSample, Kinematics
from comotion_sources.proprioception.packer import Packer, Packing
from comotion_sources.workcell import Cover, Scene, Viewpoint
from comotion_sources.workcell.atlas import build_atlas
from comotion_sources.workcell.scene import scene_folder

from .setup import CAMERA_A, CAMERA_B, ROBOT, Setup

Message: TypeAlias = TruthBatch | ObservationBatch
Sources: TypeAlias = dict[str, list[Message]]
_SESSION = "0" * 16
_WORLD = CameraSpace("world", "m", 3)
_COVERED = ".covered"
_PRODUCERS = (
    *(f"klt.{name}" for name in ("config", "corners", "depth", "flow", "observer", "template", "tracker")),
    *(f"proprioception.{name}" for name in ("kinematics", "packer")),
    *(
        f"workcell.{name}"
        for name in ("atlas", "drawing", "render", "scene", "sensor", "shapes", "textures", "viewpoint")
    ),
)


@dataclass(frozen=True)
class Recording:
    """The messages of every source of one seed of one scene, in time order.

    `sources` has one entry per source; camera A occurs twice, as it is and covered.
    """

    sources: Mapping[str, list[Message]]

    def of(self, source: str, *, covered: bool) -> list[Message]:
        """Messages of a source; camera A's own depend on whether it is covered."""
        return self.sources[source + _COVERED if covered and source == CAMERA_A else source]


def record(scene: str, seed: int, setup: Setup, cache: Path | None = None) -> Recording:
    """Render and track a scene, or read it from the cache.

    Parameters
    ----------
    scene, seed
        Of the workcell.
    setup
        Cameras, rates and cover.
    cache
        Folder to keep messages in; what was made by other code or another set-up is not used.
    """
    return Recording(keep(cache, f"{scene}-{seed}", setup, lambda: _make(scene, seed, setup)))


def keep(cache: Path | None, name: str, setup: object, make: Callable[[], Sources]) -> Sources:
    """Read the messages of sources from a cache, or make them and keep them there.

    Parameters
    ----------
    cache
        Folder; None: make them every time.
    name
        Begins the name of the file.
    setup
        What they are made with, published apart by its `repr`; code and scenes are seen to here.
    make
        Makes the messages of each source.
    """
    path = None if cache is None else cache / f"{name}-{_fingerprint(setup)}.msgpack"
    if path is not None and path.is_file():
        packed = msgpack.unpackb(path.read_bytes())
        return {source: [_read(raw) for raw in raws] for source, raws in packed.items()}
    sources = make()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        packed = {source: [encode(m) for m in messages] for source, messages in sources.items()}
        partial = path.with_suffix(".partial")
        partial.write_bytes(msgpack.packb(packed))
        partial.replace(path)
    return sources


def _read(raw: bytes) -> Message:
    message = decode(raw)
    if not isinstance(message, TruthBatch | ObservationBatch):
        raise KnownError(f"{type(message).__name__} in the cache")
    return message


def _fingerprint(setup: object) -> str:
    """Digest of the set-up, and of all code and scenes that the messages depend on."""
    digest = hashlib.sha256(repr(setup).encode())
    for name in _PRODUCERS:
        module = importlib.import_module(f"comotion_sources.{name}")
        assert module.__file__ is not None  # noqa: S101 - none of them is a namespace package
        digest.update(Path(module.__file__).read_bytes())
    for path in sorted(scene_folder().glob("*.xml")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _make(name: str, seed: int, setup: Setup) -> Sources:
    scene = Scene.named(name, seed)
    atlas = build_atlas(scene.model, seed)
    seconds = setup.duration or scene.period
    config = TrackerConfig(max_features=setup.features)
    a, b = (Viewpoint(scene, camera, setup.size, atlas=atlas) for camera in ("a", "b"))
    sources: Sources = {CAMERA_A: [], CAMERA_A + _COVERED: [], CAMERA_B: []}
    for open_, covered in track(a, config, CAMERA_A, setup.rate_a, seconds, Cover(*setup.cover)):
        sources[CAMERA_A] += open_
        sources[CAMERA_A + _COVERED] += covered
    for open_, _ in track(b, config, CAMERA_B, setup.rate_b, seconds):
        sources[CAMERA_B] += open_
    sources[ROBOT] = list(robot_messages(scene, setup.rate_robot, seconds))
    return sources


def track(
    view: Viewpoint,
    config: TrackerConfig,
    source: str,
    rate: float,
    seconds: float,
    cover: Cover | None = None,
    *,
    depth: bool = True,
) -> Iterator[tuple[list[Message], list[Message]]]:
    """Render and track; messages of each frame, twice: as it is, and with the lens covered for a while.

    Parameters
    ----------
    view
        The camera, in its scene.
    config
        Of the tracker.
    source
        Name of the source.
    rate, seconds
        Hz, and how long.
    cover
        When the lens is covered; never by default, and then the second messages are none.
    depth
        False: a plain camera, whose features are in pixels, in a space of its own.
    """
    scene = view.scene
    intrinsics = view.intrinsics if depth else None
    trackers = [Tracker(config, intrinsics) for _ in range(1 if cover is None else 2)]
    extrinsics = view.extrinsics if depth else None
    space = choose_space(source, has_depth=depth, intrinsics=intrinsics, extrinsics=extrinsics)
    observers = [Observer(space, _builder(source, space), scene.objects) for _ in trackers]
    for index in range(round(seconds * rate)):
        stamp = round(index * 1e9 / rate)
        frame = view.frame(scene.configuration(index / rate), stamp)
        seen = [frame]
        if cover is not None:
            seen.append(view.covered(stamp) if cover.hides(index / rate) else frame)
        published = [
            list(observer.messages(tracker.step(one), one))
            for one, tracker, observer in zip(seen, trackers, observers, strict=True)
        ]
        yield published[0], published[-1] if cover is not None else []


def robot_messages(scene: Scene, rate: float, seconds: float) -> Iterator[Message]:
    """Poses of the robot's links, with joint positions rounded to encoder counts as a robot's are."""
    kinematics = Kinematics(scene.model, scene.robot)
    packer, builder = Packer(kinematics, Packing(rate=rate)), _builder(ROBOT)
    numbers = [scene.object_of(link) for link in kinematics.links]
    yield builder.truth(ids=np.arange(len(numbers), dtype=np.uint64), objects=numbers, names=scene.objects)
    for index in range(round(seconds * rate)):
        reading = JointSample(round(index * 1e9 / rate), scene.joints, scene.configuration(index / rate))
        pack = packer.add(kinematics.encoded(reading))
        if pack is not None:
            yield builder.observation(
                stamp_ns=pack.stamp_ns,
                ids=pack.ids,
                positions=pack.positions,
                sigma=pack.sigma,
                quaternions=pack.quaternions,
                stamps_ns=pack.stamps_ns,
            )


def _builder(source: str, space: CameraSpace = _WORLD) -> MessageBuilder:
    return MessageBuilder(source=source, session=_SESSION, space=space.name, unit=space.unit, dim=space.dim)
