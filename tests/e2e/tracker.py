"""A source of two bodies, in a thread of a test or as a process: ``tracker.py`` with the JSON of `main`."""

import itertools
import json
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np

from comotion_schemas import ObservationBatch, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings, stream_publisher
from comotion_tools.processes import DEADLINE


@contextmanager
def every(seconds, step):
    """Call ``step(0)``, ``step(1)`` and so on, in a thread, for as long as the context lasts."""
    over = threading.Event()

    def run():
        for seq in itertools.count():
            if over.wait(seconds):
                return
            step(seq)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join(DEADLINE)


def until(condition, meanwhile=lambda: None):
    """Look again and again until something is so."""
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, "what was awaited did not come"
        meanwhile()
        time.sleep(0.005)


def until_heard(publisher):
    """Wait until the session knows of a subscriber; until then Zenoh drops what is put."""
    matched = threading.Event()
    listener = publisher.declare_matching_listener(lambda status: status.matching and matched.set())
    if publisher.matching_status.matching:
        matched.set()
    assert matched.wait(DEADLINE)
    listener.undeclare()
    return publisher


class Tracker:
    """Tracks twelve features in metres: the first six move along x, the others along y."""

    def __init__(self, component, space="world", rate=20.0):
        self._component, self._space, self._rate = component, space, rate
        self._rest = np.random.default_rng(7).random((12, 3)) * 0.4
        self.publisher = stream_publisher(component.session, component.keys, "obs", component.name)
        self.sent = 0

    def batch(self, seq):
        """What it sees now."""
        stamp_ns = time.time_ns()
        positions = self._rest.copy()
        swing = 0.3 * np.sin(2 * np.pi * 0.5 * (stamp_ns % 10**12) / 1e9)
        positions[:6, 0] += swing
        positions[6:, 1] += 1.0 + swing
        return ObservationBatch(
            source=self._component.name,
            session=self._component.session_id,
            seq=seq,
            space=self._space,
            unit="m",
            dim=3,
            stamp_ns=stamp_ns,
            ids=np.arange(12, dtype=np.uint64),
            positions=positions.astype(np.float32),
        )

    def send(self, seq):
        self.publisher.put(encode(self.batch(seq)))
        self.sent = seq + 1

    def running(self):
        """Publish for as long as the context lasts."""
        return every(1 / self._rate, self.send)


def main(endpoint, name, scene="default", ahead_s=0.0, **options):
    """Publish until stopped, by a clock that is so far ahead."""
    clock = time.time_ns
    time.time_ns = lambda: clock() + round(ahead_s * 1e9)
    settings = SessionSettings(connect=(endpoint,))
    with Component(role="source", name=name, scene=scene, settings=settings) as component:
        tracker = Tracker(component, **options)
        component.ready()
        until_heard(tracker.publisher)
        with tracker.running():
            component.stop.wait()


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))
