"""A source that drifts away from the others: said, and the bodies that others see keep their ids."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion_schemas import ObservationBatch

from .. import builders

SECOND = 10**9
RATE = 15
BODIES = 3
START = 10**18
Change = Callable[[np.ndarray, float], np.ndarray]


def swings(t: float) -> np.ndarray:
    """Shifts of the bodies at a time: the first one rests."""
    return np.array([[0, 0, 0], [0.5, 0.3 * np.sin(1.4 * t), 0], [-0.5, 0, 0.3 * np.sin(1.9 * t + 1)]])


def batch(source: int, k: int, features: int, change: Change) -> ObservationBatch:
    """What a source sees, as `change` makes it."""
    t = (k + source / 3) / RATE
    own = np.random.default_rng(source).uniform(-0.2, 0.2, (BODIES, features, 3))
    own[0] *= 4
    rows = (own + swings(t)[:, None]).reshape(-1, 3)
    rows += np.random.default_rng([source, k]).normal(0, 0.002, rows.shape)
    stamp, session = START + round(t * SECOND), f"{source + 1:016x}"
    return builders.batch("abc"[source], k, stamp, change(rows, t), session=session)


class Scene:
    """Three sources, of which the last has as many features as the others together."""

    features = 5, 5, 10

    def __init__(self) -> None:
        self.fusion = Fusion(FusionConfig())
        self.k = 0

    def run(self, seconds: float, change: Change = lambda rows, t: rows) -> list[dict[int, int]]:
        """The hypothesis of each body, as most features of the first two sources have it, every 0.2 s."""
        ids = []
        for _ in range(round(seconds * RATE)):
            for source, count in enumerate(self.features):
                unchanged = source < len(self.features) - 1
                same = batch(source, self.k, count, (lambda rows, t: rows) if unchanged else change)
                self.fusion.ingest(same)
            self.k += 1
            if self.k % 3 == 0:
                self.fusion.update(START + round(self.k / RATE * SECOND))
                ids.append(self._ids())
        return ids

    def _ids(self) -> dict[int, int]:
        update = self.fusion._latest
        votes: dict[int, Counter[int]] = {}
        for source, feature, one in zip(
            update.track_source, update.track_id, update.track_hypothesis, strict=True
        ):
            name = "abc".index(update.sources[source].name)
            if name < 2:
                votes.setdefault(int(feature) // self.features[name], Counter())[int(one)] += 1
        return {body: counts.most_common(1)[0][0] for body, counts in votes.items()}

    @property
    def drifting(self) -> list[str]:
        return list(self.fusion.timeline.troubles.lately().get("drifts", ()))


def turned(since: float, until: float = 1e9) -> Change:
    """Turns by 0.05 rad/s about the vertical axis from one time to another."""

    def change(rows: np.ndarray, t: float) -> np.ndarray:
        angle = 0.05 * (min(t, until) - since)
        cos, sin = np.cos(angle), np.sin(angle)
        return rows @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])

    return change


def late(rate: float) -> Change:
    """Sees everything later and later, from the 5th second on."""

    def change(rows: np.ndarray, t: float) -> np.ndarray:
        shift = swings(t - rate * max(t - 5, 0)) - swings(t)
        return rows + np.repeat(shift, len(rows) // BODIES, 0)

    return change


def test_the_ids_of_what_others_see_stay_and_the_source_is_named() -> None:
    scene = Scene()
    before = scene.run(5.0)[-1]
    assert len(set(before.values())) == BODIES
    assert scene.drifting == []
    during = scene.run(8.0, turned(5.0))
    assert scene.drifting == ["c"]
    assert all(one == before for one in during)
    update = scene.fusion._latest
    drifts = update.track_source == next(k for k, one in enumerate(update.sources) if one.name == "c")
    assert update.track_confidence[drifts].max() <= np.float32(0.4)
    assert np.median(update.track_confidence[~drifts]) > 0.9


@pytest.mark.parametrize("rate", [0.02, 0.05])
def test_the_ids_of_what_others_see_stay_where_its_delay_grows(rate) -> None:
    scene = Scene()
    before = scene.run(5.0)[-1]
    after = scene.run(6.0, late(rate))
    assert scene.drifting == ["c"]
    assert all(ids == before for ids in after)


def test_what_has_stopped_drifting_takes_part_again() -> None:
    scene = Scene()
    scene.run(5.0)
    scene.run(3.0, turned(5.0, 8.0))
    assert scene.drifting == ["c"]
    # What was seen last is told for 3 s.
    scene.run(10.0, turned(5.0, 8.0))
    assert scene.drifting == []


@pytest.mark.parametrize(
    "change",
    [
        lambda rows, t: turned(0.0)(rows, 0.5),
        lambda rows, t: rows + 0.01,
        lambda rows, t: rows + np.repeat([[0], [0], [max(t - 4, 0) * 0.05]], 10, 0),
        late(0.01),
        lambda rows, t: rows + np.repeat(swings(t - 0.25) - swings(t), 10, 0),
    ],
    ids=["a lasting turn", "a lasting shift", "one body", "a delay that hardly grows", "a lasting latency"],
)
def test_a_lasting_offset_or_one_body_is_no_drift(change) -> None:
    scene = Scene()
    for _ in range(16):
        scene.run(0.5, change)
        assert scene.drifting == []


def test_of_two_sources_that_which_sees_the_background_rest_is_believed() -> None:
    scene = Scene()
    scene.features = 8, 12
    scene.run(5.0)
    scene.run(4.0, turned(5.0))
    assert scene.drifting == ["b"]


def test_a_source_whose_clock_is_known_to_be_wrong_is_not_compared(monkeypatch) -> None:
    scene = Scene()
    scene.run(5.0)
    known = {"clock-ahead": {"c"}}
    asked = lambda *kinds: set().union(*(known.get(kind, set()) for kind in kinds))  # noqa: E731
    monkeypatch.setattr(scene.fusion.timeline.troubles, "sources", asked)
    scene.run(4.0, turned(5.0))
    monkeypatch.undo()
    assert scene.drifting == []


def test_a_source_below_10_hz_is_not_judged(monkeypatch) -> None:
    monkeypatch.setattr(f"{__name__}.RATE", 8)
    scene = Scene()
    scene.run(5.0)
    scene.run(6.0, turned(5.0))
    assert scene.drifting == []
