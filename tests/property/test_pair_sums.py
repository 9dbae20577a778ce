"""The incremental sums hold what (3.2), (3.3) and (3.5) say, whatever happened to the window."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.thesis import equations

from ..reference import thesis as literal
from ..reference.side_by_side import MS, T0, Point, SideBySide

_LAST_MS = 2200


@st.composite
def tracks(draw: st.DrawFn, dim: int) -> dict[int, dict[int, Point]]:
    """Trajectories of different rates, phases, lifetimes, gaps and motions; times on a 10 ms grid."""
    found: dict[int, dict[int, Point]] = {}
    for track in range(draw(st.integers(2, 5))):
        period = draw(st.sampled_from([20, 30, 70, 100, 250, 600]))
        phase = draw(st.integers(0, 9)) * 10 % period
        birth, life = draw(st.integers(0, 150)) * 10, draw(st.integers(1, 220)) * 10
        gap = draw(st.integers(0, 200)) * 10
        gap_end = gap + draw(st.sampled_from([0, 0, 200, 450, 600, 1300]))
        rng = np.random.default_rng(draw(st.integers(0, 2**16)))
        amplitude, pace, centre = rng.uniform(0, 0.5, dim), rng.uniform(0, 6, dim), rng.normal(0, 1, dim)
        times = [
            t
            for t in range(birth - birth % period + phase, min(birth + life, _LAST_MS), period)
            if t >= birth and not gap <= t < gap_end
        ]
        noise = rng.normal(0, draw(st.sampled_from([0.0, 0.003])), (len(times), dim))
        found[track] = {
            T0 + t * MS: tuple(centre + amplitude * np.sin(pace * t * 1e-3) + noise[n])
            for n, t in enumerate(times)
        }
    return found


@st.composite
def scripts(draw: st.DrawFn) -> tuple[int, list[tuple[int, int, dict[int, Point]]]]:
    """(dim, instants as (arrival, stamp, points)): some arrive late, some together with others."""
    dim = draw(st.sampled_from([2, 3]))
    scene = draw(tracks(dim))
    lateness = draw(st.sampled_from([0, 200, 700]))
    late_share = draw(st.sampled_from([0.1, 0.5]))
    one_by_one = draw(st.booleans())
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    instants: list[tuple[int, int, dict[int, Point]]] = []
    for stamp in sorted({t for times in scene.values() for t in times}):
        points = {track: times[stamp] for track, times in scene.items() if stamp in times}
        for group in [{k: x} for k, x in points.items()] if one_by_one else [points]:
            late = int(rng.integers(0, lateness + 1)) * MS if rng.uniform() < late_share else 0
            instants.append((stamp + late, stamp, group))
    return dim, sorted(instants, key=lambda instant: instant[:2])


@settings(max_examples=100)
@given(script=scripts(), v_move=st.sampled_from([None, 0.1, 1.0]), every=st.integers(1, 400))
def test_sums_equal_the_definitions(script, v_move, every):
    dim, instants = script
    both = SideBySide(dim, v_move)
    checked = evicted = T0
    for arrival, stamp, points in instants:
        both.observe(stamp, points)
        if arrival - evicted >= every * MS:
            evicted = arrival
            both.evict(arrival - both.span)
        if arrival - checked >= 500 * MS:
            checked = arrival
            both.check()
    both.check()
    both.check_affinities()


@settings(max_examples=20)
@given(script=scripts(), v_move=st.sampled_from([None, 0.1]))
def test_sums_computed_anew_are_those_carried_along(script, v_move):
    dim, instants = script
    both = SideBySide(dim, v_move)
    for arrival, stamp, points in instants:
        both.observe(stamp, points)
        both.evict(arrival - both.span)
    both.pairs.forget(both.window.slots())
    both.check()


@settings(max_examples=50)
@given(scene=st.sampled_from([2, 3]).flatmap(tracks), v_move=st.sampled_from([None, 0.1, 1.0]))
def test_the_equations_equal_the_definitions(scene, v_move):
    gap = 500 * MS
    plain = [literal.Trajectory(dict(points)) for points in scene.values() if points]
    whole = []
    for points in scene.values():
        if points:
            times, x = np.array(sorted(points)), np.array([points[t] for t in sorted(points)])
            whole.append(equations.Observations(times, x, equations.backward_speed(times, x)))
    for i, one in enumerate(plain):
        for j, other in enumerate(plain[:i]):
            pairs = literal.samples(one, other, gap)
            distance, speed = equations.distance_samples(whole[i], whole[j], gap)
            np.testing.assert_allclose(distance, [d for d, _ in pairs], rtol=1e-9)
            np.testing.assert_allclose(speed**2, [v for _, v in pairs], rtol=1e-9)
            if len(pairs) >= 2:
                found = equations.variance(distance, equations.weight(speed, v_move))
                expected = literal.variance(one, other, gap, v_move)
                np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)
                want = literal.affinity(one, other, gap, v_move, 0.02)
                np.testing.assert_allclose(equations.affinity(np.array(found), 0.02), want, rtol=1e-6)


def test_weight_is_0_9_at_the_target_velocity_and_small_but_not_zero_at_rest():
    w = equations.weight(np.array([0.0, 0.1, 1.0]), 0.1)
    assert w == pytest.approx([0.0023, 0.9, 1.0], rel=0.01)


def at(ms: float) -> int:
    return T0 + round(ms * MS)


@pytest.mark.parametrize("wild", [(0, 1000), (1000,)])
def test_a_wild_observation_leaves_no_trace_after_it_has_gone(wild):
    both = SideBySide(2, 0.1)
    rng = np.random.default_rng(0)
    for ms in range(0, 3000, 50):
        points = {k: np.array([k, 0.0]) + rng.normal(0, 1e-3, 2) for k in range(4)}
        if ms in wild:
            points[2] = np.array([1e9, -1e9])
        both.observe(at(ms), {k: tuple(x) for k, x in points.items()})
        both.evict(at(ms) - both.span)
        if ms in (1950, 2000, 2050, 2500):
            both.check()
    assert len(both.slots) == 4


@pytest.mark.parametrize("step", [0, 30])
def test_small_motion_far_apart_keeps_its_digits(step):
    both = SideBySide(2, 0.1)
    for ms in range(0, 1000, 100):
        both.observe(at(ms), {0: (0.0, 0.0)})
        both.observe(at(ms + step), {1: (1e3 + 1e-3 * math.sin(ms), 0.0)})
    both.check_affinities()
