"""Objects keep their ids through a gap that leaves the grouping without evidence, and through a restart.

The sources are those of the soak, with a seed at which ids changed before established members had votes.
"""

import heapq
from collections import Counter

import numpy as np

from comotion import Fusion, FusionConfig
from comotion_tools.soak.load import BODIES, ID_STEP, KINDS, places, positions

from .. import builders
from ..builders import S

START = 1_000 * S
SEED = 7


def stream(name, first, last):
    """Batches of a source with the times of their arrival, in s."""
    kind, rng = KINDS[name], np.random.default_rng([SEED, sum(name.encode())])
    features = places(kind, sum(name.encode()))
    ids = ID_STEP * np.arange(BODIES)[:, None] + np.arange(kind.features)
    for frame in range(int(np.ceil(first * kind.rate)), int(np.ceil(last * kind.rate))):
        seconds = frame / kind.rate + 0.003 * len(name)
        found = positions(kind, features, seconds + 1.7 * SEED)
        found = (found + rng.normal(0, 0.002, found.shape)).reshape(-1, kind.dim)
        fields = {"space": kind.space, "unit": kind.unit, "ids": ids.reshape(-1).astype(np.uint64)}
        yield seconds, builders.batch(name, frame, START + round(seconds * S), found, **fields)


def feed(fusion, *parts, since):
    """Fuse streams in the order of arrival with updates from a time in s on: the last, kinds of events."""
    due, kinds = since, set()
    for seconds, batch in heapq.merge(*parts, key=lambda part: part[0]):
        while seconds >= due:
            update = fusion.update(START + round(due * S))
            kinds |= {e.kind for e in update.events if e.stamp_ns == update.stamp_ns}
            due += 0.1
        fusion.ingest(batch)
        fusion.advance(START + round(seconds * S))
    return update, kinds


def objects_of(update):
    """Hypothesis of each body, that of most of its features."""
    bodies, labels = update.track_id // ID_STEP, update.track_hypothesis
    return [Counter(labels[bodies == body].tolist()).most_common(1)[0][0] for body in range(BODIES)]


def test_after_a_gap_longer_than_the_window_and_a_restart_every_object_has_its_id():
    """The sources come back one after the other."""
    fusion = Fusion()
    before, _ = feed(fusion, *(stream(name, 0, 8) for name in ("left", "right", "arm")), since=0.1)
    assert len(set(objects_of(before))) == BODIES
    fusion = Fusion.restore(FusionConfig(), fusion.snapshot())
    back = {"left": 38.0, "right": 38.15, "arm": 37.8}
    after, kinds = feed(fusion, *(stream(name, first, 43) for name, first in back.items()), since=37.7)
    assert objects_of(after) == objects_of(before)
    assert {h.id: h.born_ns for h in after.hypotheses} == {h.id: h.born_ns for h in before.hypotheses}
    assert kinds <= {"joined", "released"}
