"""The comparator: affinity of Brox and Malik with two clusterings."""

import numpy as np
import pytest

from comotion_experiments.brox_malik import CLUSTERINGS, affinity, compare
from comotion_sources import simulator


def two_bodies(noise=0.05, frames=40):
    """Pixels of two bodies, one of which moves; the first trajectory of each is seen for half the time."""
    rng = np.random.default_rng(0)
    at = rng.uniform(0, 200, (24, 2))
    t = np.arange(frames)[:, None, None]
    x = at + t * np.where(np.arange(24) < 12, 0.0, 2.0)[None, :, None]
    x = x + rng.normal(0, noise, x.shape)
    x[: frames // 2, [0, 12]] = np.nan
    return x, np.arange(24) >= 12


def test_the_affinity_is_high_within_a_body_and_low_between():
    x, moved = two_bodies()
    found = affinity(x, pixels=True)
    assert found == pytest.approx(found.T)
    assert (np.diag(found) == 1).all()
    same = moved[:, None] == moved[None]
    assert np.median(found[same]) > 10 * np.median(found[~same])


def test_trajectories_without_common_time_have_no_affinity():
    x, _ = two_bodies()
    x[20:, 1] = np.nan
    assert affinity(x, pixels=True)[0, 1] == 0


def test_metres_are_scaled_to_the_extent_of_the_scene():
    x, _ = two_bodies()
    assert affinity(x, pixels=False) == pytest.approx(affinity(1000 * x, pixels=False))


@pytest.mark.parametrize("name", list(CLUSTERINGS))
def test_a_clustering_finds_blocks(name):
    truth = np.repeat([0, 1, 2], 6)
    matrix = np.where(truth[:, None] == truth, 0.9, 0.02)
    np.fill_diagonal(matrix, 1.0)
    labels = CLUSTERINGS[name](matrix, 3)
    assert len(set(zip(labels.tolist(), truth.tolist(), strict=True))) == 3


def test_scenes_are_scored_every_second():
    run = simulator.simulate(simulator.load_scene("3d_2"), seed=0)
    found = compare(simulator.batches(run), 3.0)
    assert found.seconds == [1.0, 2.0, 3.0]
    assert all(0 <= value <= 1 for value in found.means().values())
