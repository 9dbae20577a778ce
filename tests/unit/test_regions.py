"""Dense regions from labelled features."""

import numpy as np
import pytest

from comotion_experiments.regions import NOBODY, intersection_over_union, regions

pytest.importorskip("skimage")


def picture():
    """A bright disc on a dark ground, and the true object of each pixel."""
    y, x = np.mgrid[0:120, 0:160]
    disc = (x - 90) ** 2 + (y - 50) ** 2 < 30**2
    rng = np.random.default_rng(0)
    image = np.where(disc, 180, 60)[..., None] + rng.normal(0, 6, (120, 160, 3))
    return image.clip(0, 255).astype(np.uint8), disc.astype(np.int32)


def test_regions_end_at_the_edges_of_the_image():
    image, true = picture()
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [159, 119], (60, 2)).astype(np.float32)
    labels = np.where(true[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] == 1, 7, 3)
    labels[:5] = -1
    found = regions(image, pixels, labels)
    assert set(np.unique(found)) == {3, 7}
    scores = intersection_over_union(found, true)
    assert scores[0] > 0.95
    assert scores[1] > 0.9


def test_one_label_or_none_needs_no_image():
    image, _ = picture()
    nowhere = np.zeros((0, 2), np.float32)
    assert (regions(image, nowhere, np.zeros(0, np.int64)) == NOBODY).all()
    assert (regions(image, np.array([[5, 5]], np.float32), np.array([4])) == 4).all()


def test_features_outside_the_image_do_no_harm():
    image, _ = picture()
    pixels = np.array([[5, 5], [90, 50], [500, 500]], np.float32)
    assert set(np.unique(regions(image, pixels, np.array([1, 2, 9])))) == {1, 2}


def test_the_overlap_ignores_ambiguous_pixels():
    true = np.array([[0, 0, 1, -1]], np.int32)
    assert intersection_over_union(np.array([[5, 5, 6, 5]]), true) == {0: 1.0, 1: 1.0}
    assert intersection_over_union(np.array([[5, 6, 6, 6]]), true) == pytest.approx({0: 0.5, 1: 0.5})
