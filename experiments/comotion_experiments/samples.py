"""Samples to look at before there is data of one's own: ``python -m comotion_experiments.samples FOLDER``.

A simulated scene goes through the core; what a recording of it would hold is written for Foxglove and for
Rerun. Needs the extras `foxglove` and `view`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import foxglove

from comotion import FusionConfig
from comotion_clients.feed import play
from comotion_clients.foxglove.scene import FoxgloveScene
from comotion_clients.metrics import Score
from comotion_clients.viewing.picture import ScenePicture
from comotion_clients.viewing.sink import RerunSink
from comotion_schemas import HypothesisUpdate, Message, ObservationBatch
from comotion_sources.simulator import batches, load_scene, simulate

from .inputs import Incoming
from .offline import run_offline

SCENE = "3d_5"
SECONDS = 6.0
NOON_NS = 1_767_268_800_000_000_000
"""Noon of a day: a viewer writes the date instead of the time where a scene begins at midnight."""


def make(folder: Path) -> list[Path]:
    """Write the samples; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{SCENE}.mcap", folder / f"{SCENE}.rrd"]
    for file in files:
        file.unlink(missing_ok=True)
    messages = played(SCENE, SECONDS)
    context = foxglove.Context()
    with foxglove.open_mcap(files[0], context=context):
        play(FoxgloveScene(context), messages)
    with RerunSink(file=files[1]) as sink:
        play(ScenePicture(SCENE, sink=sink), messages)
    return files


def played(scene: str, seconds: float) -> list[tuple[int, Message]]:
    """What a recorder would have received of a simulated scene: (time in ns, message) in order."""
    messages: list[tuple[int, Message]] = []

    def noted() -> Iterator[Incoming]:
        newest_ns = NOON_NS
        for message in batches(simulate(load_scene(scene)), epoch_ns=NOON_NS):
            newest_ns = message.stamp_ns if isinstance(message, ObservationBatch) else newest_ns
            messages.append((newest_ns, message))
            yield message

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        messages.append((update.published_ns, update))

    run_offline(noted(), FusionConfig(), duration=seconds, on_update=on_update)
    return messages


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    for path in make(parser.parse_args().folder):
        print(path, path.stat().st_size)  # noqa: T201
