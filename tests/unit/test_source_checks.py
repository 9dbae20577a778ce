"""Sources whose ids, unit or clock cannot be right: what is reported and cut; others do not suffer."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import comotion
from comotion import Fusion
from comotion.runtime import health
from comotion.runtime.clocks import SourceClocks
from comotion.trajectories.jumps import jumps
from comotion.trajectories.window import Window
from comotion_schemas import Keys

from .. import builders
from ..builders import T0, S, labels_of, status

RATE = 15
BODY = np.random.default_rng(0).uniform(-0.2, 0.2, (12, 3))


def batch(k, ids, points, *, source="odd", **fields):
    return builders.batch(source, k, T0 + k * S // RATE, points, ids=ids.astype(np.uint64), **fields)


def good(k):
    noise = np.random.default_rng([k, 1]).normal(0, 0.001, BODY.shape)
    return BODY + noise + [0.0, 0.4 * np.sin(0.2 * k), 0.5]


IDS = np.arange(12)


MISTAKES = {
    "ids-short-lived": lambda k: batch(k, IDS + 12 * k, good(k)),
    "ids-reused": lambda k: batch(k, np.random.default_rng(k).permutation(12), good(k)),
    "scale": lambda k: batch(k, IDS, 1000 * good(k)),
}


def named(fusion, frames, *sources):
    """Feed sources; returns the problems at each frame."""
    found = []
    for k in frames:
        for one in filter(None, (make(k) for make in sources)):
            fusion.ingest(one)
        now = T0 + k * S // RATE
        (fusion.advance if k % 4 else fusion.update)(now, now)
        found.append(health.in_words(fusion.timeline.troubles.lately()))
    return found


def run(fusion, make, frames):
    """Feed a good source and another one; returns the problems of the last moment."""
    return named(fusion, frames, lambda k: batch(k, IDS, good(k), source="good", session="b" * 16), make)[-1]


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_is_told_with_what_to_do_until_it_ends(kind):
    fusion = Fusion()
    problems = run(fusion, MISTAKES[kind], range(60))
    assert set(problems) == {("odd", kind)}
    assert problems["odd", kind].startswith("odd: ")
    assert "; " in problems["odd", kind]
    assert run(fusion, lambda k: batch(k, 10_000 + IDS, good(k)), range(60, 180)) == {}


@pytest.mark.parametrize("rate_share", [1, 8])
def test_what_is_right_is_not_complained_about(rate_share):
    """Also a source that swings its features about, and renews a quarter of them each second."""

    def right(k):
        turn = 0.5 * k
        c, s = np.cos(turn), np.sin(turn)
        points = BODY @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) + [np.sin(0.4 * k), 0, 0]
        return batch(k, IDS + 100 * ((k + 15 * IDS) // 60), points) if k % rate_share == 0 else None

    assert run(Fusion(), right, range(150)) == {}


def test_ids_that_change_hands_now_and_then_are_told():
    """Ids are places in a list whose head is dropped once in ten batches."""
    fusion = Fusion()
    rolled = lambda k: batch(k, IDS, np.roll(good(k), k // 10, axis=0))  # noqa: E731
    problems = [set(run(fusion, rolled, range(k, k + 60))) for k in range(0, 300, 60)]
    assert problems.count({("odd", "ids-reused")}) >= 3


@pytest.mark.parametrize(("factor", "words"), [(1, "count from a start"), (1000, "Unix times in us")])
def test_a_clock_that_counts_from_a_start_is_told_from_one_in_another_unit(factor, words):
    # 3e12 ns are 50 minutes, and 3e12 ms a year of this century.
    start = 3 * 10**12 if factor == 1 else 1_700_000_000 * 10**6

    def odd(k):
        return replace(batch(k, IDS, good(k)), stamp_ns=start + k * S // RATE // factor)

    assert words in run(Fusion(), odd, range(40))["odd", "clock-zero"]


def test_ids_that_come_back_after_their_end_are_reused():
    def back(k):
        return batch(k, IDS, good(k), ended=IDS[:2].astype(np.uint64) if k == 20 else None)

    problems = run(Fusion(), back, range(60))
    assert set(problems) == {("odd", "ids-reused")}
    assert "ended" in problems["odd", "ids-reused"]


def test_a_lone_source_in_millimetres_is_told_until_it_ends():
    def ends(k):
        return batch(k, IDS + (1000 if k >= 90 else 0), good(k) * (1000 if k < 90 else 1))

    problems = named(Fusion(), range(180), ends)
    assert all(
        "if they are millimetres, divide them by 1000" in one["odd", "scale"] for one in problems[60:90]
    )
    assert problems[-1] == {}


def test_a_majority_is_believed_whoever_came_first():
    fusion, names = Fusion(), ("left", "right", "arm")

    def right(k, name):
        return batch(k, IDS, good(k), source=name, session="c" * 16) if k > 10 else None

    problems = named(fusion, range(60), MISTAKES["scale"], *(partial(right, name=name) for name in names))
    assert set(problems[-1]) == {("odd", "scale")}
    accounts = fusion.timeline.ledger.accounts
    assert all(accounts[name, "c" * 16].rejected == {} for name in names)


def test_a_crowd_of_newcomers_does_not_take_the_id_of_a_body():
    fusion = Fusion()
    crowd = np.random.default_rng(4).uniform(-0.2, 0.2, (100, 3)) + good(44).mean(0)
    floor = np.random.default_rng(5).uniform(-1, 1, (20, 3))
    ids: list[set[int]] = []
    for k in range(90):
        now = T0 + k * S // RATE
        points = np.concatenate([good(k), floor])
        fusion.ingest(batch(k, np.arange(32), points, source="good", session="b" * 16))
        if k >= 45:
            fusion.ingest(batch(k, np.arange(100), crowd))
        update = fusion.update(now)
        mine = update.track_source == [s.name for s in update.sources].index("good")
        ids.append(set(update.track_hypothesis[mine & (update.track_id < 12)].tolist()))
    assert len(ids[44]) == 1
    assert ids[-1] == ids[44]


NOW = 1_700_000_000.0
DELAY = 0.002


def clocks(*, correct=True):
    """Without answers to queries but those that a test makes up."""
    session = SimpleNamespace(get=lambda *_, **__: None)
    return SourceClocks(SimpleNamespace(session=session, keys=Keys()), correct=correct)  # type: ignore[arg-type]


def feed(followed, ahead, times, delays=None):
    """Statuses of a source whose clock is ahead, and the round trips between them."""
    for k in range(times):
        delay = DELAY if delays is None else delays[k]
        followed.on_status(status("cam", "source", stamp_ns=round((NOW + k + ahead) * 1e9)), NOW + k + delay)
        followed._answers.append(("cam", 2.5 * delay))


@pytest.mark.parametrize("step", [0.5, -0.5, 0.03, -0.03])
def test_a_clock_that_is_set_is_noticed_once_and_followed(step):
    followed = clocks()
    feed(followed, 0.08, 8)
    feed(followed, 0.08 + step, 8)
    assert followed.steps == 1
    assert f"{step:+.3f}"[:5] in followed.notes()[0] or abs(step) < 0.1
    assert followed.offsets()["cam"] == pytest.approx(0.08 + step, abs=2.5 * DELAY)


def test_delays_that_vary_and_a_link_that_becomes_slow_are_no_steps():
    followed = clocks()
    rng = np.random.default_rng(3)
    feed(followed, 0.0, 40, DELAY + rng.exponential(0.003, 40))
    feed(followed, 0.0, 10, np.full(10, 0.3))
    assert followed.steps == 0


def test_stamps_are_corrected_if_that_is_wanted():
    found, kept = clocks(), clocks(correct=False)
    stamp = round(NOW * 1e9)
    original = builders.batch(
        stamp_ns=stamp, positions=np.zeros((2, 3)), stamps_ns=np.array([stamp - 10, stamp])
    )
    assert found.correct(original) is original
    for one in (found, kept):
        feed(one, 0.08, 3)
    corrected = found.correct(original)
    assert (stamp - corrected.stamp_ns) / 1e9 == pytest.approx(0.08, abs=2.5 * DELAY)
    assert corrected.stamps_ns.tolist() == [corrected.stamp_ns - 10, corrected.stamp_ns]
    assert kept.correct(original) is original


HZ, COUNT = 20.0, 30
AT = 20
SOME, SWAYING = np.s_[AT:, [3, 14]], np.s_[AT:, 10:]


def scene(seed=0):
    """Ten features at rest and ten that sway, [T, 20, 3], noise 2 mm."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (1, 20, 3)).repeat(COUNT, 0)
    places[:, 10:, 0] += 0.2 * np.sin(np.arange(COUNT) / 3)[:, None]
    return places + rng.normal(0, 0.002, places.shape)


# Rows of a scene x, what they become, and which features are cut at which frame.
HAPPENS = {
    "two exchange their ids": (SOME, lambda x: x[AT:, [14, 3]], {3: AT, 14: AT}),
    "one slips": (np.s_[AT:, 12], lambda x: x[AT:, 12] + [0.1, 0, 0], {12: AT}),
    "a body jumps": (SWAYING, lambda x: x[SWAYING] + [0.0, 0.5, 0.0], {}),
    "two jump together": (np.s_[AT:, 10:12], lambda x: x[AT:, 10:12] + [0.0, 0.5, 0.0], {}),
    "all ids are others": (np.s_[AT:], lambda x: x[AT:, ::-1], {}),
    "a single error": (np.s_[AT, 4], lambda x: x[AT, 4] + 0.5, {}),
    "one starts": (np.s_[AT:, 4], lambda x: x[AT:, 4] + 0.1 * np.arange(1, COUNT - AT + 1)[:, None], {}),
    "all is rounded": (np.s_[:], lambda x: np.round(x, 2), {}),
}


@pytest.mark.parametrize(("rows", "become", "expected"), HAPPENS.values(), ids=HAPPENS)
def test_only_what_jumps_alone_and_stays_there_is_cut(rows, become, expected):
    x = scene()
    x[rows] = become(x.copy())
    window = Window(3, 10**10, 10**9)
    slots, by_slot = window.open(x.shape[1], 0), {}
    for k, positions in enumerate(x):
        window.insert(slots, 1 + round(k * 1e9 / HZ), positions, np.full(len(slots), np.nan), None)
        if k % 2:
            jumping, first = jumps(window, slots, 1 + round((k - 2) * 1e9 / HZ))
            by_slot |= dict(zip(jumping.tolist(), (first - window.start[jumping]).tolist(), strict=True))
    assert {int(np.flatnonzero(slots == slot)[0]): k for slot, k in by_slot.items()} == expected


def test_features_that_exchange_their_ids_exchange_their_hypotheses():
    x = scene()
    x = np.concatenate([x, x[::-1], x])
    x[45:, [3, 14]] = x[45:, [14, 3]]
    online = comotion.Scene(unit="m")
    for k, positions in enumerate(x):
        online.push(np.arange(20), positions, k / HZ)
    labels = labels_of(online.update())
    assert labels[3] == labels[10] != labels[0] == labels[14]
    assert len(set(labels.values())) == 2
