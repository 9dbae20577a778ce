"""The incremental sums hold what (3.2), (3.3) and (3.5) say, whatever happened to the window."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.engine import Rows
from comotion.pairs import PairSums
from comotion.window import Window

from ..reference import thesis as literal

MS = 1_000_000
SPAN, GAP = 2000 * MS, 500 * MS
T0 = 1_700_000_000_000 * MS


@dataclass
class Bench:
    """A window with its sums, and the same trajectories as plain lists, driven side by side."""

    dim: int
    v_move: float | None
    window: Window = field(init=False)
    sums: PairSums = field(init=False)
    slots: dict[int, int] = field(default_factory=dict)
    lists: dict[int, literal.Trajectory] = field(default_factory=dict)
    oldest: int = -(2**63)

    def __post_init__(self) -> None:
        self.window = Window(self.dim, SPAN, GAP)
        self.sums = PairSums(self.v_move)

    def observe(self, stamp: int, points: dict[int, tuple[float, ...]]) -> None:
        points = {track: x for track, x in points.items() if self.can_take(track, stamp)}
        for track in points:
            if track not in self.slots:
                self.slots[track] = int(self.window.open(1, 0)[0])
                self.lists[track] = literal.Trajectory()
        if not points:
            return
        for track, x in points.items():
            self.lists[track].history.setdefault(stamp, x)
        slots = np.array([self.slots[track] for track in points], np.intp)
        positions = np.array(list(points.values()), float)
        stored = self.window.insert(slots, stamp, positions, np.full(len(slots), np.nan), None)
        self.sums.observed(self.window, Rows(stamp, slots[stored], in_order=True))

    def can_take(self, track: int, stamp: int) -> bool:
        """Not older than the window, nor than what is left of a trajectory whose past has gone."""
        if stamp < self.oldest:
            return False
        if track not in self.lists:
            return True
        known = self.lists[track]
        return len(known.times()) == len(known.history) or stamp > known.times()[0]

    def evict(self, oldest: int) -> None:
        self.oldest = max(oldest, self.oldest)
        slots, counts = self.window.evictable(self.oldest)
        if len(slots):
            self.sums.evicting(self.window, slots, counts)
            self.window.evict(slots, counts)
        for track, known in list(self.lists.items()):
            known.oldest = self.oldest
            if len(known.times()) < 2:
                self.forget(track)

    def forget(self, track: int) -> None:
        del self.lists[track]
        slot = np.array([self.slots.pop(track)])
        self.sums.forget(slot)
        self.window.close(slot)

    def check(self) -> None:
        tracks = sorted(self.slots)
        if not tracks:
            return
        slots = np.array([self.slots[track] for track in tracks], np.intp)
        variance, comparable = self.sums.variance(self.window, slots)
        for a, i in enumerate(tracks):
            for b, j in enumerate(tracks):
                expected = literal.variance(self.lists[i], self.lists[j], GAP, self.v_move)
                if i == j:
                    continue
                assert comparable[a, b] == (expected is not None), (i, j)
                if expected is not None:
                    assert self.sums.samples[slots[a], slots[b]] == len(
                        literal.samples(self.lists[i], self.lists[j], GAP)
                    )
                    assert variance[a, b] == pytest.approx(expected, rel=1e-6, abs=1e-12), (i, j)
        np.testing.assert_array_equal(variance, variance.T)


@st.composite
def tracks(draw: st.DrawFn, dim: int) -> dict[int, dict[int, tuple[float, ...]]]:
    """Trajectories of different rates, phases, lifetimes, gaps and motions; times on a 10 ms grid."""
    found: dict[int, dict[int, tuple[float, ...]]] = {}
    for track in range(draw(st.integers(2, 5))):
        period = draw(st.sampled_from([10, 30, 70, 100, 250, 600]))
        phase = draw(st.integers(0, 9)) * 10 % period
        birth, life = draw(st.integers(0, 300)) * 10, draw(st.integers(1, 400)) * 10
        gap = draw(st.integers(0, 350)) * 10
        gap_end = gap + draw(st.sampled_from([0, 0, 200, 450, 600, 2500]))
        rng = np.random.default_rng(draw(st.integers(0, 2**16)))
        amplitude, pace, centre = rng.uniform(0, 0.5, dim), rng.uniform(0, 4, dim), rng.normal(0, 1, dim)
        times = [
            t
            for t in range(birth - birth % period + phase, min(birth + life, 4000), period)
            if t >= birth and not gap <= t < gap_end
        ][:120]
        noise = rng.normal(0, draw(st.sampled_from([0.0, 0.003])), (len(times), dim))
        found[track] = {
            T0 + t * MS: tuple(centre + amplitude * np.sin(pace * t * 1e-3) + noise[n])
            for n, t in enumerate(times)
        }
    return found


@st.composite
def scripts(draw: st.DrawFn) -> tuple[int, list[tuple[int, int, dict[int, tuple[float, ...]]]]]:
    """(dim, instants as (arrival, stamp, points)); some arrive late, some together with others."""
    dim = draw(st.sampled_from([2, 3]))
    scene = draw(tracks(dim))
    lateness = draw(st.sampled_from([0, 0, 300, 1200]))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    split = draw(st.booleans())
    instants: list[tuple[int, int, dict[int, tuple[float, ...]]]] = []
    for stamp in sorted({t for times in scene.values() for t in times}):
        points = {track: times[stamp] for track, times in scene.items() if stamp in times}
        for group in [{k: x} for k, x in points.items()] if split else [points]:
            late = int(rng.integers(0, lateness + 1)) * MS if lateness and rng.uniform() < 0.3 else 0
            instants.append((stamp + late, stamp, group))
    return dim, sorted(instants, key=lambda instant: instant[:2])


@settings(max_examples=150, deadline=None)
@given(script=scripts(), v_move=st.sampled_from([None, 0.1, 1.0]), every=st.integers(1, 400))
def test_sums_equal_the_definitions(script, v_move, every):
    dim, instants = script
    bench = Bench(dim, v_move)
    checked = evicted = T0
    for arrival, stamp, points in instants:
        bench.observe(stamp, points)
        if arrival - evicted >= every * MS:
            evicted = arrival
            bench.evict(arrival - SPAN)
        if arrival - checked >= 700 * MS:
            checked = arrival
            bench.check()
    bench.check()
