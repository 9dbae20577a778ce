"""Whatever well-formed batches say, the core answers with a valid update and finite affinities."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion import Fusion, FusionConfig
from comotion_schemas import decode, encode

from ..builders import T0 as START_NS
from ..builders import batch

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


def play(config, unit, dim, name, *, count=8, sigma=None):
    fusion = Fusion(config)
    rng = np.random.default_rng(1)
    for frame in range(12):
        now = START_NS + frame * FRAME_NS
        positions = np.clip(shape(name, count, dim, rng), -1e9, 1e9)
        fusion.ingest(batch("hostile", frame, now, positions, space="s", unit=unit, sigma=sigma))
        if frame % 4 == 3:
            update = fusion.update(now)
            assert encode(decode(encode(update))) == encode(update)
            # A batch without rows opens no space.
            matrix = fusion.affinity("s").matrix if count else np.zeros((0, 0))
            assert ((matrix >= 0) & (matrix <= 1)).all()
    return fusion, update


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
    play(FusionConfig(method=method, window=window), *space, name, count=count, sigma=sigma)


@pytest.mark.parametrize("method", METHODS)
def test_a_coordinate_beyond_all_measure_is_refused_as_out_of_range(method):
    fusion, update = play(FusionConfig(method=method), "m", 3, "scattered")
    now = update.published_ns + FRAME_NS
    fusion.ingest(batch("hostile", 12, now, [[0, 0, 0], [3e38, 0, 0]], space="s"))
    after = fusion.update(now)
    assert fusion.stats.rejected == {"range": 1}
    assert after.track_id.tolist() == update.track_id.tolist()


@pytest.mark.parametrize("method", METHODS)
def test_a_track_without_an_observation_in_the_window_is_not_current(method):
    fusion, update = play(FusionConfig(method=method, window=0.2, track_timeout=5), "m", 3, "scattered")
    assert len(update.track_id) == 8
    assert not len(fusion.update(update.published_ns + 900_000_000).track_id)
