"""Renders a scene of the workcell as one of its cameras sees it, and tracks features in it."""

from collections.abc import Iterator
from typing import NamedTuple

from comotion_sources.cameras.types import Frame
from comotion_sources.klt.config import TrackerConfig
from comotion_sources.klt.observer import Observer, choose_space
from comotion_sources.klt.tracker import Tracker, Tracks
from comotion_sources.streams import OFFLINE_SESSION
from comotion_sources.workcell.camera import CameraSpec, WorkcellCamera

from .inputs import Message


class Filmed(NamedTuple):
    """A frame, what is tracked in it, and what a source of that camera publishes of it."""

    frame: Frame
    tracks: Tracks
    messages: list[Message]


def filmed(spec: CameraSpec, source: str, config: TrackerConfig) -> Iterator[Filmed]:
    """Film a scene with depth; the same for the same arguments."""
    camera = WorkcellCamera(spec)
    space = choose_space(source, has_depth=True, intrinsics=camera.intrinsics, extrinsics=camera.extrinsics)
    observer = Observer(space, space.builder(source, OFFLINE_SESSION), camera.objects)
    tracker = Tracker(config, camera.intrinsics)
    for frame in camera:
        tracks = tracker.step(frame)
        yield Filmed(frame, tracks, list(observer.messages(tracks, frame)))
