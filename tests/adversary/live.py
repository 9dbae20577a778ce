"""Live against offline: what a scene comes to where the service has a share of one core (:mod:`.quota`).

Service and sources are processes; the same batches are then given to the core offline, which has all the
time. Compared are means over the updates after the first seconds.
"""

import re
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
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

SETTLED_S = 3.0
"""The first updates show too little motion for either."""
_NAME = "live"
_BACK_S = 20.0
_OPEN_S = 300.0


@dataclass
class Live:
    """One scene at one share of a core.

    `nmi`: means, live and offline. `updates`, `due`: how many came, and how many the period allows. `back_s`:
    how long after the limit nothing was left out again; None for not in 20 s.
    """

    nmi: tuple[float, float]
    updates: int
    due: int
    back_s: float | None


class _Client(Watched):
    """What goes over the wire: all batches, and the times of updates."""

    turn_s = 0.05

    def _begin(self):
        super()._begin()
        self._sources = self.subscribe(TruthBatch), self.subscribe(ObservationBatch)
        self.messages: list[Message] = []

    def turn(self):
        super().turn()
        self.messages += [message for source in self._sources for _, message in source.drain()]

    @property
    def has_batches(self):
        return any(isinstance(message, ObservationBatch) for message in self.messages)


def _processes(scene, folder, endpoint, seconds):
    at = f"--connect {endpoint} --scene {_NAME}"
    commands = {"router": f"router --listen {endpoint}", "service": f"serve --no-state {at}"}
    commands["source"] = f"source simulator {_scene_file(scene, folder, seconds)} --seed 1 {at}"
    return {name: Managed(name, (*COMOTION, *words.split()), folder) for name, words in commands.items()}


def _scene_file(scene, folder, seconds):
    """The scene for so long, and with so many features."""
    name, _, count = scene.partition(":")
    text = (Path(scenes.__path__[0]) / f"{name}.toml").read_text()
    text = re.sub(r"duration = [\d.]+", f"duration = {seconds:.1f}", text)
    if count:
        factor = int(count) / sum(map(int, re.findall(r"features = (\d+)", text)))
        text = re.sub(r"features = (\d+)", lambda match: f"features = {round(factor * int(match[1]))}", text)
    file = folder / f"{name}.toml"
    file.write_text(text)
    return file


def measure(scene, cores, seconds):
    """Run a scene of ``comotion source simulator``, ``:N`` for N features in all, for some seconds."""
    with tempfile.TemporaryDirectory() as name:
        folder, endpoint = Path(name), free_endpoint()
        settings = SessionSettings(connect=(endpoint,))
        # Long enough for what follows the measurement.
        processes = _processes(scene, folder, endpoint, seconds + _BACK_S + 5.0)
        with _Client(processes, _NAME, settings) as client, ThreadPoolExecutor(1) as thread:
            client.start("service")
            client.until(lambda: client.monitor.last)
            client.start("source")
            client.until(lambda: client.has_batches)
            limit = (sys.executable, quota.__file__, str(processes["service"].pid), str(cores))
            limited = Managed("quota", limit, folder)
            limited.start()
            began = time.monotonic()
            del client.monitor.arrived_s[:-1]
            evaluated = thread.submit(evaluate, scene=_NAME, settings=settings, duration=seconds, quiet=True)
            client.is_so(evaluated.done, _OPEN_S)
            scores, took = evaluated.result().scores, time.monotonic() - began
            arrived, messages = client.monitor.arrived_s[:], client.messages[:]
            limited.end()
            back_s = _back(client)
        batches = [message for message in messages if isinstance(message, ObservationBatch)]
        batches.sort(key=lambda batch: batch.stamp_ns)
        truths = [message for message in messages if isinstance(message, TruthBatch)]
        offline = run_offline([*truths, *batches], FusionConfig()).scores
        settled_ns = batches[0].stamp_ns + round(SETTLED_S * 1e9)
        nmi = _mean_nmi(scores, settled_ns), _mean_nmi(offline, settled_ns)
        return Live(nmi, len(arrived) - 1, int(took / FusionConfig().period), back_s)


def _back(client):
    """How long until nothing is left out."""
    began = time.monotonic()
    while (passed := time.monotonic() - began) < _BACK_S:
        replies = client.session.get(client.keys.query("status"), timeout=2.0)
        states = [decode_as(Status, reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]
        if states and " (level " not in states[0].message:
            return passed
        time.sleep(0.05)
    return None


def _mean_nmi(scores, settled_ns):
    return float(np.nanmean([score.nmi for score in scores if score.stamp_ns >= settled_ns]))
