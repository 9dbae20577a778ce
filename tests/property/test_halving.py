"""The compiled parts of divisive k-means against NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.thesis.kernels.halving import cut, gather, means, multiply, nearer

from ..reference import halving

seeds = st.integers(0, 2**32 - 1)
sizes = st.one_of(st.integers(1, 30), st.sampled_from([95, 96, 97, 98, 130, 300]))


def triangle(rng, size):
    """A symmetric matrix of which only what is at and below the diagonal can be read."""
    matrix = rng.uniform(0, 1, (size, size)).astype(np.float32)
    matrix[np.triu_indices(size, 1)] = np.nan
    np.fill_diagonal(matrix, 1.0)
    return matrix


@settings(max_examples=40, deadline=None)
@given(size=sizes, seed=seeds, share=st.sampled_from([0.3, 1.0]), threads=st.booleans())
def test_gathered_rows_are_copied_and_summed(size, seed, share, threads):
    rng = np.random.default_rng(seed)
    matrix = triangle(rng, size)
    members = np.sort(rng.choice(size, max(1, int(share * size)), replace=False))
    part = rng.uniform(size=len(members)) < 0.5
    room = np.full((len(members) + 1,) * 2, np.nan, np.float32)
    in_place = bool(members[-1] == len(members) - 1)
    sums, part_sums, least = gather(matrix, members, in_place, room, part, threads)
    dense = halving.symmetric(matrix)[np.ix_(members, members)]
    np.testing.assert_allclose(sums, dense.sum(1), rtol=1e-5)
    np.testing.assert_allclose(part_sums, dense[:, part].sum(1), rtol=1e-5)
    assert least == dense.min()
    if not in_place:
        copied = room[: len(members), : len(members)]
        np.testing.assert_array_equal(np.tril(np.nan_to_num(copied)), np.tril(dense))


@settings(max_examples=40, deadline=None)
@given(size=sizes, seed=seeds, threads=st.booleans())
def test_products_are_those_of_the_whole_matrix(size, seed, threads):
    rng = np.random.default_rng(seed)
    matrix, vector = triangle(rng, size), rng.normal(size=size).astype(np.float32)
    expected = halving.symmetric(matrix) @ vector
    np.testing.assert_allclose(multiply(matrix, vector, threads), expected, atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(size=st.integers(2, 30), seed=seeds)
def test_a_step_of_two_means_is_one_on_the_rows(size, seed):
    rng = np.random.default_rng(seed)
    matrix = halving.symmetric(np.nan_to_num(triangle(rng, size)))
    second = np.arange(size) < rng.integers(1, size)
    across, threshold, scatter = means(matrix.sum(1), matrix @ second, int(second.sum()))
    first_mean, second_mean = matrix[~second].mean(0), matrix[second].mean(0)
    np.testing.assert_allclose(across, second_mean - first_mean, atol=1e-12)
    assert np.isclose(scatter, halving.scatter(matrix, second))
    closer, count, moved = nearer(matrix @ across, threshold, second)
    distances = ((matrix - first_mean) ** 2).sum(1) - ((matrix - second_mean) ** 2).sum(1)
    clear = np.abs(distances) > 1e-9
    np.testing.assert_array_equal(closer[clear], distances[clear] > 0)
    assert (count, moved) == (closer.sum(), (closer != second).sum())


@settings(max_examples=60, deadline=None)
@given(values=st.lists(st.integers(-20, 20), min_size=2, max_size=30))
def test_a_cut_is_that_of_two_means_on_numbers(values):
    # Binary fractions with few digits: their sums are exact in any order.
    score = np.array(values, np.float64) / 4
    found, expected = cut(score), halving.cut(score)
    np.testing.assert_array_equal(found, expected)
