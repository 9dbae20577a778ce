"""A workcell scene seen by camera A: scene and seed -> messages, kept on disk."""

from pathlib import Path

from comotion_sources.klt import TrackerConfig
from comotion_sources.workcell import Scene

from ..fusion.setup import CAMERA_A, Setup
from ..offline import Message
from ..rendered import Sources, filmed, keep

LIVE = Setup(size=(640, 480), features=400)
"""As ``comotion source klt workcell:SCENE/a`` without options."""


def camera_messages(scene: str, seed: int, cache: Path | None, how: Setup = LIVE) -> list[Message]:
    """Messages of the KLT tracker of camera A over one period of a scene."""

    def make() -> Sources:
        config = TrackerConfig(max_features=how.features)
        size, opened = how.size, Scene.named(scene, seed)
        return {
            CAMERA_A: filmed(opened, "a", CAMERA_A, config, size=size, rate=how.rate_a, seconds=how.duration)[
                0
            ]
        }

    return keep(cache, f"joints-{scene}-{seed}", how, make)[CAMERA_A]
