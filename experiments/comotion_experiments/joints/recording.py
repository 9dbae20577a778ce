"""A workcell scene seen by camera A: scene and seed -> messages, kept on disk."""

from pathlib import Path

from comotion_sources.klt import TrackerConfig
from comotion_sources.workcell import Scene, Viewpoint

from ..fusion.recording import Message, keep, track
from ..fusion.setup import CAMERA_A, Setup

LIVE = Setup(size=(640, 480), features=400)
"""As ``comotion source klt workcell:SCENE/a`` without options."""


def camera_messages(scene: str, seed: int, cache: Path | None, how: Setup = LIVE) -> list[Message]:
    """Messages of the KLT tracker of camera A over one period of a scene."""

    def make() -> dict[str, list[Message]]:
        opened = Scene.named(scene, seed)
        view = Viewpoint(opened, "a", how.size)
        seconds = how.duration or opened.period
        config = TrackerConfig(max_features=how.features)
        found = [m for open_, _ in track(view, config, CAMERA_A, how.rate_a, seconds) for m in open_]
        return {CAMERA_A: found}

    return keep(cache, f"joints-{scene}-{seed}", how, make)[CAMERA_A]
