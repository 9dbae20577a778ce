"""Live against offline: what a scene comes to where the service has a share of one core.

    PYTHONPATH=tests python -m adversary.live [--cores 1,0.5,0.25] [--seconds 20] [SCENE...]

A scene is a name of ``comotion source simulator --list``, with ``:N`` for N features in all, or ``workcell``.
Service and sources are processes; the service alone is limited (:mod:`.quota`). The same batches are then
given to the core offline, which has all the time. Printed are the means over the updates after the first
seconds, and how long it takes until nothing is left out once the service has a whole core again.
"""

import argparse
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np

from comotion import FusionConfig
from comotion_clients.evaluate import evaluate
from comotion_clients.metrics import Score
from comotion_clients.subscription import Subscription
from comotion_deploy.demo import free_endpoint
from comotion_deploy.processes import PYTHON
from comotion_experiments.inputs import Message
from comotion_experiments.offline import run_offline
from comotion_schemas import HypothesisUpdate, Keys, ObservationBatch, Status, TruthBatch, decode_as
from comotion_schemas.transport import SessionSettings, client_settings, connect
from comotion_sources import scenes
from comotion_tools.soak.processes import Managed

from . import quota

SCENES = ("3d_4:60", "3d_4:300", "3d_4:1000", "3d_async", *(["workcell"] if find_spec("mujoco") else []))
CORES = (1.0, 0.5, 0.25)
SETTLED_S = 3.0
"""The first updates show too little motion for either."""
_NAME = "live"
_BACK_S = 20.0
_WORKCELL = {
    "truck": "source workcell truck",
    "klt-a": "source klt workcell:truck/a?size=320x240&rate=15 --name klt-a --max-features 120",
    "klt-b": "source external-camera workcell:truck/b?size=320x240&rate=7.5 --name klt-b --max-features 120",
    "gripper": "source proprioception workcell:truck --name gripper",
}


@dataclass
class Live:
    """One scene at one share of a core.

    Attributes
    ----------
    nmi, hypotheses
        Means, live and offline.
    updates, due, gap_s
        How many came, how many the period allows, and the longest time between two.
    level, back_s
        Highest level of shedding, and how long after the limit it was 0 again; None for not in 20 s.
    """

    scene: str
    cores: float
    nmi: tuple[float, float]
    hypotheses: tuple[float, float]
    updates: int
    due: int
    gap_s: float
    level: int
    back_s: float | None

    def __str__(self) -> str:
        back = "-" if self.back_s is None else f"{self.back_s:.1f} s"
        scores = [*(f"{one:.3f}" for one in self.nmi), *(f"{one:.1f}" for one in self.hypotheses)]
        came = f"{self.updates} of {self.due}", f"{self.gap_s:.2f} s"
        return f"| {' | '.join([self.scene, f'{self.cores:g}', *scores, *came, str(self.level), back])} |"


_COLUMNS = "scene, cores, NMI live, offline, hypotheses live, offline, updates, longest gap, level, back"
HEAD = f"| {_COLUMNS.replace(', ', ' | ')} |\n|---|{9 * '---:|'}"


@dataclass
class _Heard:
    """What went over the wire."""

    messages: list[Message] = field(default_factory=list)
    arrived_s: list[float] = field(default_factory=list)
    level: int = 0


@contextmanager
def _listening(endpoint: str) -> Iterator[_Heard]:
    """Keep all batches, the times of updates, and the highest level."""
    heard, over = _Heard(), threading.Event()

    def listen() -> None:
        with (
            connect(client_settings([endpoint]), timeout=60) as session,
            Subscription(session, ObservationBatch, _NAME, capacity=8192) as batches,
            Subscription(session, TruthBatch, _NAME, capacity=8192) as truths,
            Subscription(session, HypothesisUpdate, _NAME, capacity=1024) as updates,
            Subscription(session, Status, _NAME, capacity=1024) as statuses,
        ):
            while not over.wait(0.05):
                heard.messages += [one for _, one in (*truths.drain(), *batches.drain())]
                heard.arrived_s += [at for at, _ in updates.drain()]
                heard.level = max([heard.level, *(_level(one) for _, one in statuses.drain())])

    thread = threading.Thread(target=listen)
    thread.start()
    try:
        yield heard
    finally:
        over.set()
        thread.join()


def _level(status: Status) -> int:
    found = re.search(r"level (\d+) of", status.message)
    return int(found[1]) if found else 0


def _sources(scene: str, folder: Path, endpoint: str, seconds: float) -> list[Managed]:
    at = ("--connect", endpoint, "--scene", _NAME)
    commands = _WORKCELL
    if scene != "workcell":
        commands = {"simulator": f"source simulator {_scene_file(scene, folder, seconds)} --seed 1"}
    return [
        Managed(name, (*PYTHON, "comotion_deploy", *command.split(), *at), folder)
        for name, command in commands.items()
    ]


def _scene_file(scene: str, folder: Path, seconds: float) -> Path:
    """The scene for so long, and with so many features."""
    name, _, count = scene.partition(":")
    text = (Path(scenes.__path__[0]) / f"{name}.toml").read_text()
    text = re.sub(r"duration = [\d.]+", f"duration = {seconds:.1f}", text)
    if count:
        factor = int(count) / sum(map(int, re.findall(r"features = (\d+)", text)))
        text = re.sub(r"features = (\d+)", lambda one: f"features = {round(factor * int(one[1]))}", text)
    file = folder / f"{name}.toml"
    file.write_text(text)
    return file


def measure(scene: str, cores: float, seconds: float, *, quiet: bool = True) -> Live:
    """Run a scene for some seconds with a share of a core for the service."""
    with tempfile.TemporaryDirectory() as name:
        folder, endpoint = Path(name), free_endpoint()
        at = ("--connect", endpoint, "--scene", _NAME)
        router = Managed("router", (*PYTHON, "comotion_deploy", "router", "--listen", endpoint), folder)
        service = Managed("service", (*PYTHON, "comotion_deploy", "serve", "--no-state", *at), folder)
        # Long enough for what follows the measurement.
        sources = _sources(scene, folder, endpoint, seconds + _BACK_S + 5.0)
        try:
            router.start()
            service.start()
            with _listening(endpoint) as heard:
                _until(lambda: bool(heard.arrived_s))
                for one in sources:
                    one.start()
                _until(lambda: any(isinstance(one, ObservationBatch) for one in heard.messages))
                assert service.pid is not None
                limited = Managed(
                    "quota", (sys.executable, quota.__file__, str(service.pid), str(cores)), folder
                )
                limited.start()
                del heard.arrived_s[:-1]
                heard.level, began = 0, time.monotonic()
                settings = SessionSettings(connect=(endpoint,))
                scores = evaluate(_NAME, settings, duration=seconds, quiet=quiet).scores
                arrived, took = list(heard.arrived_s), time.monotonic() - began
                messages, level = list(heard.messages), heard.level
                limited.end()
                back_s = _back(endpoint)
        finally:
            for one in (*sources, service, router):
                one.end()
        period = FusionConfig().period
        offline = _offline(messages)
        first_ns = min(one.stamp_ns for one in messages if isinstance(one, ObservationBatch))
        return Live(
            scene,
            cores,
            (_mean(scores, first_ns, "nmi"), _mean(offline, first_ns, "nmi")),
            (_mean(scores, first_ns, "hypotheses"), _mean(offline, first_ns, "hypotheses")),
            len(arrived) - 1,
            int(took / period),
            max(b - a for a, b in pairwise(arrived)),
            level,
            back_s,
        )


def _until(fulfilled: Callable[[], bool], seconds: float = 300.0) -> None:
    end = time.monotonic() + seconds
    while not fulfilled():
        assert time.monotonic() < end
        time.sleep(0.02)


def _back(endpoint: str) -> float | None:
    """How long until nothing is left out."""
    began = time.monotonic()
    with connect(client_settings([endpoint]), timeout=60) as session:
        while (passed := time.monotonic() - began) < _BACK_S:
            for reply in session.get(f"{Keys(_NAME).prefix}/query/status", timeout=2.0):
                if reply.ok is not None and not _level(decode_as(Status, reply.ok.payload.to_bytes())):
                    return passed
            time.sleep(0.05)
    return None


def _offline(messages: list[Message]) -> list[Score]:
    batches = [one for one in messages if isinstance(one, ObservationBatch)]
    truths = [one for one in messages if isinstance(one, TruthBatch)]
    ordered = sorted(batches, key=lambda one: one.stamp_ns)
    return run_offline([*truths, *ordered], FusionConfig()).scores


def _mean(scores: list[Score], first_ns: int, name: str) -> float:
    settled_ns = first_ns + round(SETTLED_S * 1e9)
    values = [getattr(one, name) for one in scores if one.stamp_ns >= settled_ns]
    return float(np.nanmean(values))


def show(scenes: Sequence[str], cores: Sequence[float], seconds: float) -> None:
    """Print the table, a line as it comes."""
    print(HEAD, flush=True)
    for scene in scenes:
        for share in cores:
            print(measure(scene, share, seconds), flush=True)


def main() -> None:
    """Print a row of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cores", type=lambda text: [float(one) for one in text.split(",")], default=CORES)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    chosen = parser.parse_args()
    if "workcell" in chosen.scenes and "workcell" not in SCENES:
        parser.error("workcell needs the extra sim3d")
    show(chosen.scenes, chosen.cores, chosen.seconds)


if __name__ == "__main__":
    main()
