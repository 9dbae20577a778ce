"""Whatever well-formed batches say, however far and large, updates are valid and others do not suffer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion import Fusion, FusionConfig
from comotion_schemas import decode, encode

from ..builders import T0, S, batch, by_feature, play

FRAME_NS = 33_000_000

METHODS = ("comotion", "thesis")
SPACES = (("m", 3), ("m", 2), ("px", 2), ("px", 3))
SHAPES = (
    "at the origin",
    "one point",
    "a line",
    "twins on a plane",
    "tiny",
    "far",
    "mixed",
    "scattered",
    "one moves",
)


def shape(name, count, dim, rng):
    """Positions [count, dim] of one frame."""
    x = np.random.default_rng(count).normal(0, 1, (count, dim))
    match name:
        case "at the origin":
            return np.zeros((count, dim))
        case "one point":
            return np.full((count, dim), 5.0)
        case "a line":
            x[:, 1:] = 0
        case "twins on a plane":
            x[:, -1] = 0.5
            x[1::2] = x[::2][: len(x[1::2])]
        case "tiny":
            x *= 1e-44
        case "far":
            x *= 10.0 ** rng.integers(-9, 9)
        case "mixed":
            x *= 10.0 ** np.linspace(-30, 9, count)[:, None]
        case "scattered":
            x = rng.normal(0, 1, (count, dim))
        case "one moves":
            x[:1] += rng.normal(0, 1)
    return x


@settings(max_examples=60)
@given(
    method=st.sampled_from(METHODS),
    space=st.sampled_from(SPACES),
    name=st.sampled_from(SHAPES),
    count=st.integers(0, 9),
    sigma=st.none() | st.sampled_from([1e-320, 1e-9, 1.0, 1e300]),
    window=st.sampled_from([0.01, 0.05, 0.3, 10.0]),
)
def test_no_noise_and_no_window_break_an_update(method, space, name, count, sigma, window):
    fusion, rng = Fusion(FusionConfig(method=method, window=window)), np.random.default_rng(1)
    for frame in range(12):
        now = T0 + frame * FRAME_NS
        positions = np.clip(shape(name, count, space[1], rng), -1e9, 1e9)
        fusion.ingest(batch("hostile", frame, now, positions, space="s", unit=space[0], sigma=sigma))
        if frame % 4 == 3:
            update = fusion.update(now)
            assert encode(decode(encode(update))) == encode(update)
            # A batch without rows opens no space.
            matrix = fusion.affinity("s").matrix if count else np.zeros((0, 0))
            assert ((matrix >= 0) & (matrix <= 1)).all()


RATE = 30


def observe(k, offset=0.0, count=6):
    """A body that rests and one that swings and turns, with noise of 1 mm, as float32 metres."""
    t = k / RATE
    shape = np.random.default_rng(0).uniform(-0.3, 0.3, (2, count, 3))
    turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    shape[1, :, :2] = shape[1, :, :2] @ turn.T + [1.0 + 0.3 * np.sin(1.7 * t), 0.4]
    positions = shape.reshape(-1, 3) + np.random.default_rng(k).normal(0, 0.001, (2 * count, 3)) + offset
    return batch("cam", k, T0 + k * S // RATE, positions)


@pytest.mark.parametrize("method", ["comotion", "thesis"])
def test_a_kilometre_from_the_origin_bodies_are_the_same(method):
    near, far = (
        play(Fusion(FusionConfig(method=method, window=4.0)), range(150), observed, every=3)[-1]
        for observed in (lambda k, _: observe(k), lambda k, _: observe(k, 1000.0))
    )
    assert len(set(near.track_hypothesis.tolist())) == 2
    # Which body has the smaller id is the same too: the order of births is that of the features.
    assert near.track_hypothesis.tolist() == far.track_hypothesis.tolist()
    for one, other in zip(near.hypotheses, far.hypotheses, strict=True):
        assert np.allclose(np.array(other.centroid) - 1000.0, one.centroid, atol=2e-4)
        assert one.state == other.state
        if one.pose is not None and other.pose is not None and method == "comotion":
            # The translation is about the origin, a kilometre away: compare where the body goes.
            assert np.allclose(one.pose.rotation, other.pose.rotation, atol=2e-3)


FAR = np.random.default_rng(2).uniform(-1, 1, (50, 3))
INTRUDERS = {
    "outliers": lambda k, seen: FAR + (0.9e9 if k > 20 else 0.0),
    "millimetres": lambda k, seen: 1000 * seen,
    "far away": lambda k, seen: FAR + 1e6,
    "without an inverse": lambda k, seen: seen,
}
COVARIANCES = {"without an inverse": np.tile([[1e30], [1e-6]], (20, 6))}  # rank one


@pytest.mark.parametrize("kind", INTRUDERS)
def test_bodies_of_a_source_stay_apart_whatever_another_source_says(kind):
    rng = np.random.default_rng(1)
    floor, first, second = (rng.uniform(-w, w, (n, 3)) for w, n in ((1, 20), (0.1, 10), (0.1, 10)))

    def good(k):
        t, noise = k / 16, np.random.default_rng(k).normal(0, 0.001, (40, 3))
        places = np.array([[0.3 * np.sin(t), 0.2, 0.5], [-0.4, 0.3 * np.sin(1.3 * t), 0.4]])
        return np.concatenate([floor, first + places[0], second + places[1]]) + noise

    update = play(
        Fusion(),
        range(48),
        lambda k, now: batch("good", k, now, good(k)),
        lambda k, now: batch("odd", k, now, INTRUDERS[kind](k, good(k)), covariance=COVARIANCES.get(kind)),
        rate=16,
        every=6,
    )[-1]
    of = by_feature(update)
    groups = [{of["good", k] for k in ids} for ids in (range(20), range(20, 30), range(30, 40))]
    assert [len(group) for group in groups] == [1, 1, 1]
    assert len(set.union(*groups)) == 3
