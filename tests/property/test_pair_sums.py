"""The incremental sums hold what (3.2), (3.3) and (3.5) say, whatever happened to the window."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.thesis.pair_sums import PairSums, weight
from comotion.trajectories.window import Window

from ..builders import MS, T0
from ..reference import thesis

_LAST_MS = 2200
SPAN, GAP, SIGMA_SWITCH = 1000 * MS, 500 * MS, 0.02


class SideBySide:
    """A window with its sums, and all that was ever observed: {track: {time: position}}; checks compare."""

    def __init__(self, dim, v_move):
        self.v_move, self.oldest = v_move, -(2**63)
        self.window, self.pairs = Window(dim, SPAN, GAP), PairSums(v_move, SIGMA_SWITCH)
        self.slots, self.history = {}, {}

    def times(self, track):
        """Of what is in the window."""
        return [t for t in sorted(self.history[track]) if t >= self.oldest]

    def observe(self, stamp, points):
        """One instant: {track: position}; new tracks are opened."""
        points = {track: x for track, x in points.items() if self._can_take(track, stamp)}
        if not points:
            return
        for track, x in points.items():
            if track not in self.slots:
                self.slots[track] = int(self.window.open(1, 0)[0])
            self.history.setdefault(track, {}).setdefault(stamp, x)
        slots, positions = self.slots_of(points), np.array(list(points.values()), float)
        self.window.insert(slots, stamp, positions, np.full(len(slots), np.nan), None)

    def slots_of(self, tracks):
        return np.array([self.slots[track] for track in tracks], np.intp)

    def _can_take(self, track, stamp):
        """Not older than the window, nor than what is left of a trajectory whose past has gone."""
        if stamp < self.oldest or track not in self.history:
            return stamp >= self.oldest
        left = self.times(track)
        return len(left) == len(self.history[track]) or stamp > left[0]

    def evict(self, oldest):
        """Drop what is older; forget what is left too short and is not observed any more."""
        self.oldest = max(oldest, self.oldest)
        slots, counts = self.window.evictable(self.oldest)
        if len(slots):
            self.pairs.evicting(self.window, slots, counts)
            self.window.evict(slots, counts)
        for track, known in list(self.history.items()):
            if len(self.times(track)) < 2 and max(known) < self.oldest + SPAN - GAP:
                del self.history[track]
                slot = np.array([self.slots.pop(track)])
                self.pairs.forget(slot)
                self.window.close(slot)

    def expected(self, i, j):
        """(3.4) of a pair by the equations; 0.5 where it cannot be compared."""
        pair = []
        for track in (i, j):
            known = self.history[track]
            times = np.array(sorted(known))
            x, inside = np.array([known[t] for t in times.tolist()]), times >= self.oldest
            speed = thesis.backward_speed(times, x)
            pair.append(thesis.Observations(times[inside], x[inside], speed[inside]))
        if min(len(one.times) for one in pair) < 2:
            return 0.5
        distance, speed = thesis.distance_samples(*pair, GAP)
        if len(distance) < 2:
            return 0.5
        return float(thesis.affinity(thesis.variance(distance, weight(speed, self.v_move)), SIGMA_SWITCH))

    def check(self):
        """Affinities are equal to 1e-5."""
        tracks, matrix = sorted(self.slots), self.pairs.affinity(self.window)
        rows = self.slots_of(tracks)
        part = matrix[np.ix_(rows, rows)]
        for a, i in enumerate(tracks):
            for b, j in enumerate(tracks[:a]):
                assert part[a, b] == part[b, a] == pytest.approx(self.expected(i, j), abs=1e-5), (i, j)


@st.composite
def tracks(draw, dim):
    """Trajectories of different rates, phases, lifetimes, gaps and motions; times on a 10 ms grid."""
    matrices = {}
    for track in range(draw(st.integers(2, 5))):
        period = draw(st.sampled_from([20, 30, 70, 100, 250, 600]))
        phase = draw(st.integers(0, 9)) * 10 % period
        birth, life = draw(st.integers(0, 150)) * 10, draw(st.integers(1, 220)) * 10
        gap = draw(st.integers(0, 200)) * 10
        gap_end = gap + draw(st.sampled_from([0, 0, 200, 450, 600, 1300]))
        rng = np.random.default_rng(draw(st.integers(0, 2**16)))
        amplitude, pace, centre = rng.uniform(0, 0.5, dim), rng.uniform(0, 6, dim), rng.normal(0, 1, dim)
        every = range(birth - birth % period + phase, min(birth + life, _LAST_MS), period)
        times = [t for t in every if t >= birth and not gap <= t < gap_end]
        noise = rng.normal(0, draw(st.sampled_from([0.0, 0.003])), (len(times), dim))
        matrices[track] = {
            T0 + t * MS: tuple(centre + amplitude * np.sin(pace * t * 1e-3) + noise[n])
            for n, t in enumerate(times)
        }
    return matrices


@st.composite
def scripts(draw):
    """(dim, instants as (arrival, stamp, points)): some arrive late, some together with others."""
    dim = draw(st.sampled_from([2, 3]))
    scene = draw(tracks(dim))
    lateness = draw(st.sampled_from([0, 200, 700]))
    late_share = draw(st.sampled_from([0.1, 0.5]))
    one_by_one = draw(st.booleans())
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    instants = []
    for stamp in sorted({t for times in scene.values() for t in times}):
        points = {track: times[stamp] for track, times in scene.items() if stamp in times}
        for group in [{k: x} for k, x in points.items()] if one_by_one else [points]:
            late = int(rng.integers(0, lateness + 1)) * MS if rng.uniform() < late_share else 0
            instants.append((stamp + late, stamp, group))
    return dim, sorted(instants, key=lambda instant: instant[:2])


@settings(max_examples=100)
@given(script=scripts(), v_move=st.sampled_from([None, 0.1, 1.0]), every=st.integers(1, 400))
def test_sums_equal_the_equations(script, v_move, every):
    dim, instants = script
    both = SideBySide(dim, v_move)
    checked = evicted = T0
    for arrival, stamp, points in instants:
        both.observe(stamp, points)
        if arrival - evicted >= every * MS:
            evicted = arrival
            both.evict(arrival - SPAN)
        if arrival - checked >= 500 * MS:
            checked = arrival
            both.check()
    both.check()
    # Computed anew, they are those carried along.
    both.pairs.forget(both.window.slots())
    both.check()


def test_the_equations_of_a_pair_are_those_of_the_thesis_by_hand():
    """One is seen every 100 ms, the other between; only the other moves, at 1 m/s, from 3 m to 3.3 m."""
    ms = np.arange(0, 400, 100) * MS
    one = thesis.Observations(ms, np.zeros((4, 1)), np.zeros(4))
    x = 3.0 + np.arange(4)[:, None] / 10
    other = thesis.Observations(ms + 50 * MS, x, thesis.backward_speed(ms, x))
    distance, speed = thesis.distance_samples(one, other, GAP)
    # From 50 to 300 ms: at the instants of either.
    assert distance == pytest.approx([3.0, 3.05, 3.1, 3.15, 3.2, 3.25])
    assert speed == pytest.approx([1.0] * 6)
    assert [len(thesis.distance_samples(one, other, ms * MS)[0]) for ms in (99, 100)] == [0, 6]
    variance = thesis.variance(distance, weight(speed, 0.1))
    assert variance == pytest.approx(np.var(distance))
    assert thesis.affinity(np.array([0.0, 1.0, 4.0]), 1.0) == pytest.approx([1, 0.5, 0.5**4])
    weights = weight(np.array([0.0, 0.1, 1.0]), 0.1)
    assert weights == pytest.approx([0.0023, 0.9, 1.0], rel=0.01)
    assert thesis.variance(np.array([1.0, 2.0]), np.array([3.0, 1.0])) == pytest.approx(3 / 16)


@pytest.mark.parametrize("wild", [(0, 1000), (1000,)])
def test_a_wild_observation_leaves_no_trace_after_it_has_gone(wild):
    both = SideBySide(2, 0.1)
    rng = np.random.default_rng(0)
    for ms in range(0, 3000, 50):
        points = {k: np.array([k, 0.0]) + rng.normal(0, 1e-3, 2) for k in range(4)}
        if ms in wild:
            points[2] = np.array([1e9, -1e9])
        both.observe(T0 + ms * MS, {k: tuple(x) for k, x in points.items()})
        both.evict(T0 + ms * MS - SPAN)
        if ms in (1950, 2000, 2050, 2500):
            both.check()
    assert len(both.slots) == 4


@pytest.mark.parametrize("step", [0, 30])
def test_small_motion_far_apart_keeps_its_digits(step):
    both = SideBySide(2, 0.1)
    for ms in range(0, 1000, 100):
        both.observe(T0 + ms * MS, {0: (0.0, 0.0)})
        both.observe(T0 + (ms + step) * MS, {1: (1e3 + 1e-3 * math.sin(ms), 0.0)})
    both.check()
