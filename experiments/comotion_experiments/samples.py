"""Samples to look at before there is data of one's own: ``python -m comotion_experiments.samples FOLDER``.

A simulated scene goes through the core; what a recording of it would hold is written for Foxglove and for
Rerun. Needs the extras `foxglove` and `view`.
"""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import foxglove

from comotion import FusionConfig
from comotion_clients.following import play
from comotion_clients.foxglove.scene import FoxgloveScene
from comotion_clients.metrics import Score
from comotion_clients.viewing.picture import Drawn, ScenePicture
from comotion_clients.viewing.sink import RerunSink
from comotion_schemas import HypothesisUpdate, Message, ObservationBatch, Preview, Status

from .inputs import Arrived, Incoming, find_inputs
from .offline import run_offline

SCENE = "sim:3d_5"
SECONDS = 6.0
NOON_NS = 1_767_268_800_000_000_000
"""Noon of a day: a viewer writes the date instead of the time where a scene begins at midnight."""
Stamped = TypeVar("Stamped", ObservationBatch, Preview, Status)


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
        play(FoxgloveScene(context), messages)
    with RerunSink(file=files[1]) as sink:
        play(Drawn(sink, ScenePicture(name)), messages)
    return files


def played(scene: str, seconds: float) -> list[tuple[int, Message]]:
    """What a recorder would have received of a scene: (time in ns, message) in order."""
    (scene_input,) = find_inputs([scene])
    return received(scene_input.open(), seconds)


def received(given: Iterable[Incoming], seconds: float) -> list[tuple[int, Message]]:
    """Messages of sources, their stamps counted from noon, and between them the updates of the core."""
    moved = (at_noon(message) if isinstance(message, ObservationBatch) else message for message in given)
    messages: list[tuple[int, Message]] = []

    def on_update(update: HypothesisUpdate, score: Score) -> None:
        del score
        messages.append((update.published_ns, update))

    run_offline(_noted(moved, messages), FusionConfig(), duration=seconds, on_update=on_update)
    return messages


def _noted(given: Iterable[Incoming], messages: list[tuple[int, Message]]) -> Iterator[Incoming]:
    newest_ns = NOON_NS
    for message in given:
        if isinstance(message, ObservationBatch):
            newest_ns = max(newest_ns, message.stamp_ns)
        messages.append((newest_ns, message.batch if isinstance(message, Arrived) else message))
        yield message


def at_noon(message: Stamped) -> Stamped:
    """A message whose stamps count from :data:`NOON_NS`."""
    moved: dict[str, Any] = {"stamp_ns": message.stamp_ns + NOON_NS}
    if isinstance(message, ObservationBatch) and message.stamps_ns is not None:
        moved["stamps_ns"] = message.stamps_ns + NOON_NS
    return replace(message, **moved)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    for path in make(parser.parse_args().folder):
        print(path, path.stat().st_size)  # noqa: T201
