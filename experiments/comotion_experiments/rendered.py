"""Renders and tracks scenes of the workcell: camera -> messages of a source, kept on disk."""

import hashlib
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import msgpack

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_schemas.errors import KnownError
from comotion_sources.cameras.types import Frame
from comotion_sources.frames import MessageBuilder
from comotion_sources.klt import Tracker, TrackerConfig, Tracks
from comotion_sources.klt.observer import CameraSpace, Observer, choose_space
from comotion_sources.streams import OFFLINE_SESSION
from comotion_sources.workcell import Cover, Scene, Viewpoint
from comotion_sources.workcell.atlas import Atlas
from comotion_sources.workcell.scene import scene_folder

from .offline import Message

Sources: TypeAlias = dict[str, list[Message]]
WORLD = CameraSpace("world", "m", 3)
_PRODUCERS = (
    *(f"klt.{name}" for name in ("config", "corners", "depth", "flow", "observer", "template", "tracker")),
    *(f"proprioception.{name}" for name in ("kinematics", "packer")),
    *(
        f"workcell.{name}"
        for name in ("atlas", "drawing", "render", "scene", "sensor", "shapes", "textures", "viewpoint")
    ),
)


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


def filmed(
    scene: Scene,
    camera: str,
    source: str,
    tracker: TrackerConfig,
    *,
    size: tuple[int, int],
    rate: float,
    seconds: float | None = None,
    depth: bool = True,
    cover: Cover | None = None,
    atlas: Atlas | None = None,
    on_frame: Callable[[Frame, Tracks], None] = lambda *_: None,
) -> tuple[list[Message], list[Message]]:
    """Render and track what a camera sees.

    Parameters
    ----------
    scene, camera
        The scene, and the name of its camera.
    source, tracker
        Name of the source, and parameters of its tracker.
    size, rate, seconds
        Width and height in px, Hz, and how long; one period of the scene by default.
    depth
        False: a plain camera, whose features are in pixels, in a space of its own.
    cover
        When the lens is covered; never by default.
    atlas
        Textures of the scene, for callers with several cameras.
    on_frame
        Called with each frame and what is tracked in it.

    Returns
    -------
    The messages as it is, and those with the lens covered for a while; none without `cover`.
    """
    view = Viewpoint(scene, camera, size, atlas=atlas)
    intrinsics = view.intrinsics if depth else None
    extrinsics = view.extrinsics if depth else None
    space = choose_space(source, has_depth=depth, intrinsics=intrinsics, extrinsics=extrinsics)
    covers = [None] if cover is None else [None, cover]
    trackers = [Tracker(tracker, intrinsics) for _ in covers]
    observers = [Observer(space, message_builder(source, space), scene.objects) for _ in covers]
    found: tuple[list[Message], list[Message]] = [], []
    for index in range(round((seconds or scene.period) * rate)):
        t, stamp = index / rate, round(index * 1e9 / rate)
        frame = view.frame(scene.configuration(t), stamp)
        for messages, covering, one, observer in zip(found, covers, trackers, observers, strict=False):
            hidden = covering is not None and covering.hides(t)
            seen = view.covered(stamp) if hidden else frame
            tracks = one.step(seen)
            on_frame(seen, tracks)
            messages.extend(observer.messages(tracks, seen))
    return found


def message_builder(source: str, space: CameraSpace = WORLD, *, moving: bool = False) -> MessageBuilder:
    """Build messages of a source in a space, by default the world."""
    return MessageBuilder(
        source=source,
        session=OFFLINE_SESSION,
        space=space.name,
        unit=space.unit,
        dim=space.dim,
        moving=moving,
    )
