"""Renders and tracks a scene: scene and seed -> messages of all sources, cached on disk."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comotion_sources.klt import TrackerConfig
from comotion_sources.proprioception import JointSample, Kinematics
from comotion_sources.proprioception.packer import Packer
from comotion_sources.workcell import Cover, Scene
from comotion_sources.workcell.atlas import build_atlas

from ..offline import Message
from ..rendered import Sources, filmed, keep, message_builder
from .setup import CAMERA_A, CAMERA_B, ROBOT, Setup

_COVERED = ".covered"


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


def _make(name: str, seed: int, setup: Setup) -> Sources:
    scene = Scene.named(name, seed)
    atlas, seconds = build_atlas(scene.model, seed), setup.duration or scene.period
    config, cover = TrackerConfig(max_features=setup.features), Cover(*setup.cover)
    how: dict[str, Any] = {"size": setup.size, "seconds": seconds, "atlas": atlas}
    open_, covered = filmed(scene, "a", CAMERA_A, config, rate=setup.rate_a, cover=cover, **how)
    return {
        CAMERA_A: open_,
        CAMERA_A + _COVERED: covered,
        CAMERA_B: filmed(scene, "b", CAMERA_B, config, rate=setup.rate_b, **how)[0],
        ROBOT: list(robot_messages(scene, setup.rate_robot, seconds)),
    }


def robot_messages(scene: Scene, rate: float, seconds: float) -> Iterator[Message]:
    """Poses of the robot's links, with joint positions rounded to encoder counts as a robot's are."""
    kinematics = Kinematics(scene.model, scene.robot)
    packer, builder = Packer(kinematics, rate=rate), message_builder(ROBOT)
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
