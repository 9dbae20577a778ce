"""Samples to look at before there is data of one's own: ``python -m comotion_experiments.samples FOLDER``.

A simulated scene goes through the core; what a recording of it would hold is written for Foxglove and for
Rerun. Needs the extras `foxglove` and `view`.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import foxglove

from comotion import FusionConfig
from comotion_clients.following import play
from comotion_clients.foxglove.scene import FoxgloveScene
from comotion_clients.metrics import Score
from comotion_clients.viewing.picture import Drawn, ScenePicture
from comotion_clients.viewing.sink import RerunSink
from comotion_schemas import HypothesisUpdate, Message, ObservationBatch

from .inputs import Arrived, Incoming, find_inputs
from .offline import run_offline

SCENE = "sim:3d_5"
SECONDS = 6.0
NOON_NS = 1_767_268_800_000_000_000
"""Noon of a day: a viewer writes the date instead of the time where a scene begins at midnight."""


def make(folder: Path) -> list[Path]:
    """Write the samples; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    name = SCENE.partition(":")[2]
    files = [folder / f"{name}.mcap", folder / f"{name}.rrd"]
    for file in files:
        file.unlink(missing_ok=True)
    messages = played(SCENE, SECONDS)
    context = foxglove.Context()
    with foxglove.open_mcap(files[0], context=context):
        scene = FoxgloveScene(context)
        for log_ns, message in messages:
            scene.add(log_ns, message)
    with RerunSink(file=files[1]) as sink:
        play(Drawn(sink, ScenePicture(name)), messages)
    return files


def played(scene: str, seconds: float) -> list[tuple[int, Message]]:
    """What a recorder would have received of a scene: (time in ns, message) in order, counted from noon."""
    messages: list[tuple[int, Message]] = []

    def on_update(update: HypothesisUpdate, score: Score) -> None:
        del score
        messages.append((update.published_ns, update))

    def noted() -> Iterator[Incoming]:
        newest_ns = NOON_NS
        (scene_input,) = find_inputs([scene])
        for message in scene_input.open():
            moved = at_noon(message) if isinstance(message, ObservationBatch) else message
            assert not isinstance(moved, Arrived)  # noqa: S101 - of recordings alone
            newest_ns = moved.stamp_ns if isinstance(moved, ObservationBatch) else newest_ns
            messages.append((newest_ns, moved))
            yield moved

    run_offline(noted(), FusionConfig(), duration=seconds, on_update=on_update)
    return messages


def at_noon(batch: ObservationBatch) -> ObservationBatch:
    """A batch whose stamps count from :data:`NOON_NS`."""
    stamps = None if batch.stamps_ns is None else batch.stamps_ns + NOON_NS
    return replace(batch, stamp_ns=batch.stamp_ns + NOON_NS, stamps_ns=stamps)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    for path in make(parser.parse_args().folder):
        print(path, path.stat().st_size)  # noqa: T201
