"""A source that drifts away from the others: it is named, and the bodies that others see keep their ids."""

from collections import Counter
from itertools import repeat

import numpy as np
import pytest

from comotion import Fusion
from comotion.hypotheses import drift

from .. import builders
from ..builders import S

BODIES = 3
START = 10**18


def swings(t):
    """Shifts of the bodies at a time: the first one rests."""
    return np.array([[0, 0, 0], [0.5, 0.3 * np.sin(1.4 * t), 0], [-0.5, 0, 0.3 * np.sin(1.9 * t + 1)]])


class Scene:
    """Sources of three bodies; by default the last has as many features of each as the others together."""

    def __init__(self, features=(5, 5, 10), rate=15):
        self.features, self.rate = features, rate
        self.fusion, self.k = Fusion(), 0

    def batch(self, source, change):
        """What a source sees, as `change` makes it."""
        t = (self.k + source / 3) / self.rate
        own = np.random.default_rng(source).uniform(-0.2, 0.2, (BODIES, self.features[source], 3))
        own[0] *= 4
        rows = (own + swings(t)[:, None]).reshape(-1, 3)
        rows += np.random.default_rng([source, self.k]).normal(0, 0.002, rows.shape)
        stamp, session = START + round(t * S), f"{source + 1:016x}"
        return builders.batch("abc"[source], self.k, stamp, change(rows, t), session=session)

    def run(self, seconds, change):
        """The hypothesis of each body, as most features of the first two sources have it, every 0.2 s.

        The last source sees what `change` makes of rows [n, 3] at a time.
        """
        ids = []
        for _ in range(round(seconds * self.rate)):
            for source in range(len(self.features)):
                is_last = source == len(self.features) - 1
                self.fusion.ingest(self.batch(source, change if is_last else same))
            self.k += 1
            if self.k % 3 == 0:
                self.update = self.fusion.update(START + round(self.k / self.rate * S))
                ids.append(self._ids())
        return ids

    def _ids(self):
        votes = {}
        for (name, feature), one in builders.by_feature(self.update).items():
            if name in "ab":
                body = feature // self.features["abc".index(name)]
                votes.setdefault(body, Counter())[one] += 1
        return {body: counts.most_common(1)[0][0] for body, counts in votes.items()}

    @property
    def drifting(self):
        return list(self.fusion.timeline.troubles.lately().get("drifts", ()))


def same(rows, t):
    return rows


def turned(since, until=1e9):
    """Turns by 0.05 rad/s about the vertical axis from one time to another."""

    def change(rows, t):
        angle = 0.05 * (min(t, until) - since)
        cos, sin = np.cos(angle), np.sin(angle)
        return rows @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])

    return change


def behind(delay):
    """Sees everything so late as `delay` says of a time."""
    return lambda rows, t: rows + np.repeat(swings(t - delay(t)) - swings(t), len(rows) // BODIES, 0)


def late(rate):
    """Sees everything later and later, from the 5th second on."""
    return behind(lambda t: rate * max(t - 5, 0))


# What the last source sees from the 5th second on, and for how many seconds.
CHANGES = {"it turns": (turned(5.0), 8.0), "its delay grows": (late(0.02), 6.0), "faster": (late(0.05), 6.0)}


@pytest.mark.parametrize(("change", "seconds"), CHANGES.values(), ids=CHANGES)
def test_the_ids_of_what_others_see_stay_and_the_source_is_named(change, seconds):
    scene = Scene()
    before = scene.run(5.0, same)[-1]
    assert len(set(before.values())) == BODIES
    assert scene.drifting == []
    during = scene.run(seconds, change)
    assert scene.drifting == ["c"]
    assert all(ids == before for ids in during)
    names = [source.name for source in scene.update.sources]
    drifts = scene.update.track_source == names.index("c")
    assert scene.update.track_confidence[drifts].max() <= np.float32(0.4)
    assert np.median(scene.update.track_confidence[~drifts]) > 0.9


AT_FIRST = 5.0, same, ""
# How a scene is made, and of each part its seconds, what the last source sees, and who drifts after it.
STORIES = {
    # What was seen last is told for 3 s.
    "it has stopped": ({}, [AT_FIRST, (3.0, turned(5.0, 8.0), "c"), (10.0, turned(5.0, 8.0), "")]),
    "of two, that which sees the background rest": (
        {"features": (8, 12)},
        [AT_FIRST, (4.0, turned(5.0), "b")],
    ),
    "not below 10 Hz": ({"rate": 8}, [AT_FIRST, (6.0, turned(5.0), "")]),
}
LASTING = {
    "a lasting turn": lambda rows, t: turned(0.0)(rows, 0.5),
    "a lasting shift": lambda rows, t: rows + 0.01,
    "one body": lambda rows, t: rows + np.repeat([[0], [0], [max(t - 4, 0) * 0.05]], 10, 0),
    "a delay that hardly grows": late(0.01),
    "a lasting latency": behind(lambda t: 0.25),
}
STORIES |= {name: ({}, list(repeat((0.5, change, ""), 16))) for name, change in LASTING.items()}


@pytest.mark.parametrize(("how", "parts"), STORIES.values(), ids=STORIES)
def test_who_drifts(how, parts):
    scene = Scene(**how)
    for seconds, change, drifting in parts:
        scene.run(seconds, change)
        assert "".join(scene.drifting) == drifting


def test_a_source_whose_clock_is_known_to_be_wrong_is_not_compared(monkeypatch):
    scene = Scene()
    scene.run(5.0, same)
    known = {"clock-ahead": {"c"}}
    troubled = lambda *kinds: set().union(*(known.get(kind, set()) for kind in kinds))  # noqa: E731
    monkeypatch.setattr(scene.fusion.timeline.troubles, "sources", troubled)
    scene.run(4.0, turned(5.0))
    monkeypatch.undo()
    assert scene.drifting == []


def motion_of(first, last):
    """The motion of one body, from where its features are first and last."""
    seen = np.zeros(len(first), [*((n, float, first.shape[1]) for n in ("first", "last")), ("label", int)])
    seen["first"], seen["last"] = first, last
    return drift._motions(seen)


def test_motions_of_flat_or_thin_bodies_are_rotations_and_say_nothing_else():
    """A plane is not turned over, and a line leaves a rotation open."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        first = rng.normal(0, 0.05, (4, 2))
        motion = motion_of(first, first + rng.normal(0, 0.01, (4, 2)))
        assert motion.R.shape == (1, 2, 2)
        assert np.linalg.det(motion.R) == pytest.approx(1)
        assert motion.freedom == 5
    line = np.outer(np.arange(5.0), [1, 0, 0])
    motion = motion_of(line, line + 1)
    assert np.allclose(motion.R, np.eye(3))
    assert np.allclose(motion.t, 1)
