"""2-means on the rows of a matrix in NumPy: what the compiled products, means and cuts must give."""

import numpy as np


def symmetric(matrix):
    """The whole of a matrix of which only what is at and below the diagonal counts."""
    lower = np.tril(matrix).astype(np.float64)
    return lower + np.tril(lower, -1).T


def scatter(matrix, second):
    """(3.6) for two halves of the rows, less the sum of all squared rows."""
    halves = matrix[~second], matrix[second]
    return sum(((half - half.mean(0)) ** 2).sum() for half in halves) - (matrix**2).sum()


def cut(score):
    """Two halves of numbers by three steps of 2-means; all but the least where one half is empty."""
    threshold, second = score.mean(), score > score.min()
    for _ in range(3):
        above = score > threshold
        if above.all() or not above.any():
            return score > score.min()
        second, threshold = above, (score[above].mean() + score[~above].mean()) / 2
    return second
