"""Tracks as real sensors and filters give them: correlated, repeated, with gross errors."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import comotion

RATE, FRAMES, TRUTH = 30, 240, np.repeat([0, 1, 2], 8)


def scene(rng):
    """Positions [T, N, 3] of a background and two bodies that swing and turn, without noise."""
    t = np.arange(FRAMES) / RATE
    points = rng.uniform(-1, 1, (len(TRUTH), 3))
    for k in (1, 2):
        points[k == TRUTH] = rng.uniform(-0.8, 0.8, 3) + rng.normal(0, 0.1, (8, 3))
    found = np.tile(points, (FRAMES, 1, 1))
    for k in (1, 2):
        angle = 0.5 * np.sin(1.3 * k * t)
        turn = np.zeros((FRAMES, 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 1, 0], turn[:, 2, 2] = np.sin(angle), 1.0
        turn[:, 0, 1] = -turn[:, 1, 0]
        centre = points[k == TRUTH].mean(0)
        shift = 0.2 * np.stack([np.sin((k + 0.5) * t), np.cos(k * t) - 1, 0 * t], 1)
        moved = np.einsum("fij,nj->fni", turn, points[k == TRUTH] - centre) + centre
        found[:, k == TRUTH] = moved + shift[:, None]
    return found


def white(rng, clean):
    return clean + rng.normal(0, 0.002, clean.shape)


def with_gross_errors(rng, clean):
    wrong = rng.random(clean.shape[:2]) < 0.05
    return white(rng, clean) + wrong[..., None] * rng.normal(0, 0.5, clean.shape)


def filtered(rng, clean):
    return clean + gaussian_filter1d(rng.normal(0, 0.01, clean.shape), 3, axis=0)


def published_twice(rng, clean):
    return np.repeat(white(rng, clean), 2, axis=0)


@pytest.mark.parametrize("spoil", [white, with_gross_errors, filtered, published_twice])
def test_bodies_are_found_in_spoilt_tracks(spoil):
    rng = np.random.default_rng(1)
    positions = spoil(rng, scene(rng))
    times = np.arange(len(positions)) * FRAMES / RATE / len(positions)
    labels = comotion.group(positions, times).labels[len(times) // 2 :]
    for now in labels[::10]:
        pairs = set(zip(TRUTH.tolist(), now.tolist(), strict=True))
        assert len(pairs) == len(set(now.tolist())) == 3
