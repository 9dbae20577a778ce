"""What moves, and what only has parallax, before a camera that moves."""

from collections import Counter

import numpy as np
import pytest

from comotion import Fusion
from comotion.pixels.gains import group_gain, rest_gain
from comotion.pixels.recent import SCALES_NS, Recent
from comotion.pixels.steadying import Steadying
from comotion_schemas import UNDETERMINED

from .. import builders
from ..builders import T0, S, labels_of

# Features of the ground, of what stands near the camera, and of a box that may move.
GROUND, NEAR, BOX = 120, 60, 20
N = GROUND + NEAR + BOX
STEPS, NOISE_PX = 40, 0.2


def scene(rng):
    ground = rng.uniform([-1, -0.7, 2.0], [1, 0.7, 2.2], (GROUND, 3))
    near = rng.uniform([-0.3, -0.3, 0.8], [0.1, 0.3, 1.2], (NEAR, 3))
    return np.concatenate([ground, near, rng.uniform([0.4, -0.1, 1.7], [0.7, 0.2, 2.0], (BOX, 3))])


def eye(seconds):
    """Where a camera in the hand is, m."""
    t = np.asarray(seconds)
    return np.stack([0.2 * np.sin(1.3 * t), 0.1 * np.sin(2.1 * t + 1), 0.15 * np.sin(0.9 * t)], axis=-1)


def image(points, seconds, shift):
    points = points - eye(seconds)
    points[-BOX:] += shift(seconds)
    return 500 * points[:, :2] / points[:, 2:] + [320, 240]


def gains(shift):
    """Gains of rest after each step of a tenth of a second, [STEPS, N], all being background."""
    rng = np.random.default_rng(0)
    points, steadying, gain = scene(rng), Steadying(), []
    background = np.zeros(N, np.intp)
    for now in 3 + 0.1 * np.arange(STEPS):
        places = [
            image(points, now - ago, shift) + rng.normal(0, NOISE_PX, (N, 2))
            for ago in (0, *(scale * 1e-9 for scale in SCALES_NS))
        ]
        displacement = places[0] - np.array(places[1:])
        seen = np.ones((len(SCALES_NS), N), np.bool_)
        recent = Recent(
            np.arange(N), places[0], displacement, seen, np.full(N, NOISE_PX**2), np.zeros(seen.shape)
        )
        gain.append(rest_gain(steadying.steadied(recent, np.arange(N), background)))
    return np.array(gain)


def test_parallax_of_what_is_near_is_no_motion():
    gain = gains(lambda seconds: np.zeros(3))
    assert (gain[5:] > 0).mean() > 0.99


@pytest.mark.parametrize("way", [(0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.6)])
def test_what_moves_is_off_the_background_within_two_steps(way):
    gain = gains(lambda seconds: np.multiply(way, np.clip(seconds - 5, 0, 1)))
    assert (gain[5:20, -BOX:] > 0).mean() > 0.99
    assert (gain[22:28, -BOX:] < 0).mean() > 0.9
    assert (gain[22:28, :-BOX] > 0).mean() > 0.99


@pytest.mark.parametrize("far_px", [1e12, 1e38])
def test_a_member_that_is_immensely_far_contradicts_the_motion_of_its_group(far_px):
    rng = np.random.default_rng(0)
    place, displacement = rng.uniform(0, 640, (5, 2)), rng.normal(5, 0.3, (4, 5, 2))
    displacement[:, 0], seen = far_px, np.ones((4, 5), np.bool_)
    recent = Recent(np.arange(5), place, displacement, seen, np.full(5, 0.1), np.zeros((4, 5)))
    gain = group_gain(recent, np.ones(5, np.bool_))
    assert gain[0] < 0 < gain[1:].min()


def test_a_second_body_is_found_soon_where_one_moved_from_the_first_image_on():
    rng, fusion = np.random.default_rng(0), Fusion()
    points = scene(rng)
    later = slice(GROUND - BOX, GROUND)
    points[later] = rng.uniform([-0.7, -0.1, 1.7], [-0.4, 0.2, 2.0], (BOX, 3))
    labels = {}
    for number in range(100):
        seconds = number / 30
        points[later, 0] += 0.003 * (number > 75)
        places = image(points, seconds, lambda t: np.array([0, 0.3, 0]) * min(t, 2)) + rng.normal(
            0, NOISE_PX, (N, 2)
        )
        fusion.ingest(
            builders.batch("cam", number, T0 + number * S // 30, places, space="cam/pixels", unit="px")
        )
        if number % 3 == 2:
            labels = labels_of(fusion.update(T0 + number * S // 30))
    parts = [list(range(N))[part] for part in (slice(0, GROUND - BOX), later, slice(N - BOX, N))]
    ground, second, first = (Counter(labels[k] for k in part).most_common(1)[0] for part in parts)
    assert len({ground[0], second[0], first[0]} - {UNDETERMINED}) == 3
    assert min(second[1], first[1]) >= 0.8 * BOX
