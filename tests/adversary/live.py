"""Live against offline: what a scene comes to where the service has a share of one core (:mod:`.quota`).

Service and sources are processes; the same batches are then given to the core offline, which has all the
time. Rows hold the means over the updates after the first seconds, and how long it takes until nothing is
left out once the service has a whole core again.
"""

import re
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np

from comotion import FusionConfig
from comotion_clients.evaluate import evaluate
from comotion_deploy.demo import free_endpoint
from comotion_experiments.inputs import Message
from comotion_experiments.offline import run_offline
from comotion_schemas import ObservationBatch, Status, TruthBatch, decode_as
from comotion_schemas.transport import SessionSettings
from comotion_sources import scenes
from comotion_tools.processes import COMOTION, Managed
from comotion_tools.soak.monitor import Watched

from . import quota

SCENES = ("3d_4:60", "3d_4:300", "3d_4:1000", "3d_async", *(["workcell"] if find_spec("mujoco") else []))
"""Names of ``comotion source simulator --list``, with ``:N`` for N features in all, and the workcell."""
CORES = (1.0, 0.5, 0.25)
SETTLED_S = 3.0
"""The first updates show too little motion for either."""
_NAME = "live"
_BACK_S = 20.0
_OPEN_S = 300.0
_WORKCELL = {
    "truck": "source workcell truck",
    "klt-a": "source klt workcell:truck/a?size=320x240&rate=15 --name klt-a --max-features 120",
    "klt-b": "source external-camera workcell:truck/b?size=320x240&rate=7.5 --name klt-b --max-features 120",
    "gripper": "source proprioception workcell:truck --name gripper",
}


@dataclass
class Live:
    """One scene at one share of a core: a row of the table.

    `nmi`, `hypotheses`: means, live and offline. `updates`, `due`, `gap_s`: how many came, how many the
    period allows, and the longest time between two. `level`, `back_s`: highest level of shedding, and how
    long after the limit it was 0 again; None for not in 20 s.
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

    def __str__(self):
        back = "-" if self.back_s is None else f"{self.back_s:.1f} s"
        scores = [*(f"{one:.3f}" for one in self.nmi), *(f"{one:.1f}" for one in self.hypotheses)]
        came = f"{self.updates} of {self.due}", f"{self.gap_s:.2f} s"
        return f"| {' | '.join([self.scene, f'{self.cores:g}', *scores, *came, str(self.level), back])} |"


COLUMNS = "scene, cores, NMI live, offline, hypotheses live, offline, updates, longest gap, level, back"


class _Client(Watched):
    """What goes over the wire: all batches, the times of updates, and the highest level."""

    turn_s = 0.05

    def _begin(self):
        super()._begin()
        self._sources = self.subscribe(TruthBatch), self.subscribe(ObservationBatch)
        self.messages: list[Message] = []
        self.level = 0

    def turn(self):
        super().turn()
        self.messages += [one for source in self._sources for _, one in source.drain()]
        if self.monitor.status is not None:
            self.level = max(self.level, _level(self.monitor.status))

    @property
    def has_batches(self):
        return any(isinstance(one, ObservationBatch) for one in self.messages)


def _level(status):
    found = re.search(r"level (\d+) of", status.message)
    return int(found[1]) if found else 0


def _processes(scene, folder, endpoint, seconds):
    at = f"--connect {endpoint} --scene {_NAME}"
    commands = {"router": f"router --listen {endpoint}", "service": f"serve --no-state {at}"}
    sources = _WORKCELL
    if scene != "workcell":
        sources = {"simulator": f"source simulator {_scene_file(scene, folder, seconds)} --seed 1"}
    commands |= {name: f"{command} {at}" for name, command in sources.items()}
    return {name: Managed(name, (*COMOTION, *words.split()), folder) for name, words in commands.items()}


def _scene_file(scene, folder, seconds):
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


def measure(scene, cores, seconds):
    """Run a scene for some seconds with a share of a core for the service."""
    with tempfile.TemporaryDirectory() as name:
        folder, endpoint = Path(name), free_endpoint()
        settings = SessionSettings(connect=(endpoint,))
        # Long enough for what follows the measurement.
        processes = _processes(scene, folder, endpoint, seconds + _BACK_S + 5.0)
        with _Client(processes, _NAME, settings) as client, ThreadPoolExecutor(1) as thread:
            client.start("service")
            client.until(lambda: client.monitor.last)
            client.start(*(name for name in processes if name not in ("router", "service")))
            client.until(lambda: client.has_batches)
            limit = (sys.executable, quota.__file__, str(processes["service"].pid), str(cores))
            limited = Managed("quota", limit, folder)
            limited.start()
            client.monitor.status, client.level, began = None, 0, time.monotonic()
            del client.monitor.arrived_s[:-1]
            evaluated = thread.submit(evaluate, scene=_NAME, settings=settings, duration=seconds, quiet=True)
            client.is_so(evaluated.done, _OPEN_S)
            scores, took = evaluated.result().scores, time.monotonic() - began
            arrived, messages, level = client.monitor.arrived_s[:], client.messages[:], client.level
            limited.end()
            back_s = _back(client)
        batches = [one for one in messages if isinstance(one, ObservationBatch)]
        batches.sort(key=lambda one: one.stamp_ns)
        truths = [one for one in messages if isinstance(one, TruthBatch)]
        offline = run_offline([*truths, *batches], FusionConfig()).scores
        settled_ns = batches[0].stamp_ns + round(SETTLED_S * 1e9)
        return Live(
            scene,
            cores,
            *(
                (_mean(scores, settled_ns, what), _mean(offline, settled_ns, what))
                for what in ("nmi", "hypotheses")
            ),
            len(arrived) - 1,
            int(took / FusionConfig().period),
            max(b - a for a, b in pairwise(arrived)),
            level,
            back_s,
        )


def _back(client):
    """How long until nothing is left out."""
    began = time.monotonic()
    while (passed := time.monotonic() - began) < _BACK_S:
        for reply in client.session.get(client.keys.query("status"), timeout=2.0):
            if reply.ok is not None and not _level(decode_as(Status, reply.ok.payload.to_bytes())):
                return passed
        time.sleep(0.05)
    return None


def _mean(scores, settled_ns, what):
    return float(np.nanmean([getattr(one, what) for one in scores if one.stamp_ns >= settled_ns]))
