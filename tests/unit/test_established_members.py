"""Objects keep their ids through faults that leave the grouping without evidence for a while.

The sources are those of the soak, with seeds at which ids changed before established members had votes.
"""

import heapq
import random
from collections import Counter

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion_schemas import DecodeError, ObservationBatch, decode
from comotion_tools.soak import hostile
from comotion_tools.soak.load import BODIES, ID_STEP, KINDS, places, positions

S = 1_000_000_000
START = 1_000 * S
SOURCES = ("left", "right", "arm")


def stream(name, first, last, seed):
    """Batches of a source with the times of their arrival, in s."""
    kind, rng = KINDS[name], np.random.default_rng([seed, sum(name.encode())])
    features = places(kind, sum(name.encode()))
    ids = ID_STEP * np.arange(BODIES)[:, None] + np.arange(kind.features)
    for frame in range(int(np.ceil(first * kind.rate)), int(np.ceil(last * kind.rate))):
        seconds = frame / kind.rate + 0.003 * len(name)
        found = positions(kind, features, seconds + 1.7 * seed)
        found = found + rng.normal(0, 0.002, found.shape)
        yield (
            seconds,
            ObservationBatch(
                source=name,
                session="0" * 16,
                seq=frame,
                space=kind.space,
                unit=kind.unit,
                dim=kind.dim,
                stamp_ns=START + round(seconds * S),
                ids=ids.reshape(-1).astype(np.uint64),
                positions=found.reshape(-1, kind.dim).astype(np.float32),
            ),
        )


def crowd(first, last, seed, monkeypatch):
    """What a source sends that sends what no source should."""
    chance, session = random.Random(seed), f"{seed + 7:016x}"
    for seq in range(int((last - first) * 50)):
        seconds = first + seq / 50
        monkeypatch.setattr(hostile.time, "time_ns", lambda now=seconds: START + round(now * S))
        try:
            yield seconds, decode(chance.choice(hostile._MAKERS)(chance, session, seq))
        except DecodeError:
            continue


class Run:
    """A fusion, its last update, and the kinds of its events."""

    def __init__(self):
        self.fusion, self.update, self.kinds = Fusion(), None, Counter()

    def feed(self, *parts, since):
        """Fuse streams in the order of arrival, with updates from a time in s on."""
        due = since
        for seconds, batch in heapq.merge(*parts, key=lambda part: part[0]):
            while seconds >= due:
                self.update = self.fusion.update(START + round(due * S))
                self.kinds.update(e.kind for e in self.update.events if e.stamp_ns == self.update.stamp_ns)
                due += 0.1
            self.fusion.ingest(batch)
            self.fusion.advance(START + round(seconds * S))

    @property
    def objects(self):
        """Hypothesis of each body, that of most of its features."""
        names = [source.name for source in self.update.sources]
        known = np.isin(self.update.track_source, [names.index(name) for name in SOURCES])
        bodies, labels = self.update.track_id // ID_STEP, self.update.track_hypothesis
        return [
            Counter(labels[known & (bodies == body)].tolist()).most_common(1)[0][0] for body in range(BODIES)
        ]

    @property
    def births(self):
        """By hypothesis, ns."""
        return {one.id: one.born_ns for one in self.update.hypotheses}


def started(seed):
    run = Run()
    run.feed(*(stream(name, 0, 8, seed) for name in SOURCES), since=0.1)
    assert len(set(run.objects)) == BODIES
    run.kinds.clear()
    return run


@pytest.mark.parametrize(("seed", "gap", "restart"), [(2, 12, False), (7, 30, True)])
def test_after_a_gap_longer_than_the_window_every_object_has_its_id(seed, gap, restart):
    """The sources come back one after the other."""
    run = started(seed)
    before, births, back = run.objects, run.births, 8 + gap
    if restart:
        run.fusion = Fusion.restore(FusionConfig(), run.fusion.snapshot())
    first = {"left": back, "right": back + 0.15 * (seed % 3), "arm": back - 0.2 * (seed % 2)}
    run.feed(*(stream(name, first[name], back + 5, seed) for name in SOURCES), since=back - 0.3)
    assert run.objects == before
    assert run.births == births
    assert set(run.kinds) <= {"joined", "released"}


def test_a_hostile_source_takes_no_id_along(monkeypatch):
    seed = 2
    run = started(seed)
    before = run.objects
    for first, last in ((8, 10), (12, 15)):
        bad = crowd(first, last, seed + 100 * (first > 10), monkeypatch)
        run.feed(*(stream(name, first, last + 2, seed) for name in SOURCES), bad, since=first)
        assert run.objects == before


def test_an_id_that_was_forgotten_does_not_come_back():
    run = started(0)
    gone = run.objects[1]
    run.fusion.forget(gone)
    run.feed(*(stream(name, 8, 13, 0) for name in SOURCES), since=8)
    assert len(set(run.objects)) == BODIES
    assert gone not in run.objects
