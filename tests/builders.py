"""Messages for tests: a test names what matters to it, the rest has a plain value."""

from pathlib import Path

import numpy as np

from comotion import Fusion
from comotion_clients.metrics import tracks_of
from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, ObservationBatch, SourceRef, Status

SESSION = "a" * 16
MS = 1_000_000
S = 1_000 * MS
T0 = 1_700_000_000 * S
TWO_BODIES = Path(__file__).with_name("two_bodies.toml")
"""A scene of the simulator for 2 s: one body rests, the other moves."""


def batch(source="cam", seq=0, stamp_ns=T0, positions=((0.0, 0.0, 0.0),), **fields):
    """Positions [N, dim], in m of space world, of features 0 to N - 1."""
    positions = np.asarray(positions, np.float32)
    usual = {
        "session": SESSION,
        "space": "world",
        "unit": "m",
        "dim": positions.shape[1],
        "ids": np.arange(len(positions), dtype=np.uint64),
    }
    return ObservationBatch(
        source=source, seq=seq, stamp_ns=stamp_ns, positions=positions, **(usual | fields)
    )


def hypothesis(number, **fields):
    """A moving body of one feature at the origin of space world."""
    usual = {"space": "world", "size": 1, "born_ns": 0, "state": "moving", "centroid": [0.0, 0.0, 0.0]}
    return Hypothesis(id=number, **(usual | fields))


def update(labels=(), **fields):
    """A track of source a for each label, of features 0, 1, ...; each label is a listed hypothesis."""
    count, sizes = len(labels), {h: list(labels).count(h) for h in sorted({*labels} - {UNDETERMINED})}
    usual = {
        "scene": "lab",
        "session": SESSION,
        "seq": 0,
        "stamp_ns": S,
        "period_ns": 100 * MS,
        "sources": [SourceRef(name="a", session=SESSION)],
        "track_source": np.zeros(count, np.uint16),
        "track_id": np.arange(count),
        "track_hypothesis": labels,
        "track_confidence": [0.5] * count,
        "track_position": np.zeros((count, 3), np.float32),
        "hypotheses": [hypothesis(h, size=size) for h, size in sizes.items()],
        "events": [],
    } | fields
    return HypothesisUpdate(**({"published_ns": usual["stamp_ns"]} | usual))


def status(component="fusion", role="service", **fields):
    """A component that is well."""
    empty = {name: {} for name in ("rates", "ages", "counters", "rejected")}
    usual = {"session": SESSION, "stamp_ns": 0, "state": "ok", "message": ""} | empty
    return Status(component=component, role=role, **(usual | fields))


def labels_of(update):
    """Hypothesis of each feature; of the last source where two share an id."""
    return dict(zip(update.track_id.tolist(), update.track_hypothesis.tolist(), strict=True))


def by_feature(update):
    """Hypothesis by the name of a source and a feature of it."""
    rows = tracks_of(update).items()
    return {(name, track): label for (name, _), labels in rows for track, label in labels.items()}


def is_sorted_out(update):
    """Both bodies of the source of tests/e2e are separated, each as one hypothesis of its six features."""
    labels = [label for _, label in sorted(by_feature(update).items())]
    bodies = [{*labels[:6]}, {*labels[6:]}]
    return (
        len(labels) == 12 and UNDETERMINED not in labels and [len({*labels}), *map(len, bodies)] == [2, 1, 1]
    )


def play(fusion, frames, *sources, rate=30, every=1):
    """Feed frames of sources at a rate, in Hz; returns the updates, one for so many frames.

    A source is what it sends at a frame and its time in ns, if anything.
    """
    updates = []
    for k in frames:
        now = T0 + round(k * S / rate)
        for source in sources:
            if (seen := source(k, now)) is not None:
                fusion.ingest(seen)
        if k % every == every - 1:
            updates.append(fusion.update(now))
    return updates


def restored(fusion, *, clean=False):
    """A fusion that goes on from a snapshot of another."""
    return Fusion.restore(fusion.config, fusion.snapshot(clean=clean))


def settled(account):
    return sum([*vars(account).values()][1:7]) + sum(account.rejected.values())  # `fused` to `waiting`


def fused(timeline, now_ns):
    """What comes out of an advance, all of it fused; and the number of a session of which no more comes."""
    events = []
    timeline.advance(now_ns, None, events.append, events.append)
    return events
