"""Gaussian mixtures on the rows of the affinity matrix, chosen by BIC (fig. 3.4 of the thesis)."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from ...arrays import Floats

COVARIANCES = ("full", "diag", "spherical")
# Figure 3.5 looks at ten eigenvalues; more components of 50 to 100 trajectories have too few rows each.
_MOST_COMPONENTS = 10
# Floor of a variance, as scikit-learn had it when the thesis was written. With the 1e-6 of today a
# component of a single row is as good as certain, and the largest number of components wins.
_VARIANCE_FLOOR = 1e-3


@dataclass(frozen=True)
class Mixture:
    """One fitted mixture: its number of components, kind of covariances, BIC, and labels intp [N]."""

    components: int
    covariance: str
    bic: float
    labels: NDArray[np.intp]


def best_mixture(affinity: Floats) -> NDArray[np.intp]:
    """Labels intp [N] of the mixture with the smallest Bayesian information criterion.

    The thesis finds it to choose too many clusters; it is slow as well, since N rows have N dimensions.
    """
    if len(affinity) < 2:
        return np.zeros(len(affinity), np.intp)
    return min(mixtures(affinity), key=lambda mixture: mixture.bic).labels


def mixtures(affinity: Floats) -> Iterator[Mixture]:
    """Fit 1 to 10 components with full, diagonal and spherical covariances, as in fig. 3.4.

    Parameters
    ----------
    affinity
        float64 [N, N], N of 2 or more.
    """
    for components in range(1, min(len(affinity), _MOST_COMPONENTS) + 1):
        for covariance in COVARIANCES:
            yield _fit(affinity, components, covariance)


def _fit(rows: Floats, components: int, covariance: str) -> Mixture:
    model = GaussianMixture(components, covariance_type=covariance, reg_covar=_VARIANCE_FLOOR, random_state=0)
    with warnings.catch_warnings():
        # Fewer distinct rows than components: such a model loses by its BIC.
        warnings.simplefilter("ignore", ConvergenceWarning)
        labels: NDArray[np.intp] = model.fit_predict(rows)
    return Mixture(components, covariance, float(model.bic(rows)), labels)
