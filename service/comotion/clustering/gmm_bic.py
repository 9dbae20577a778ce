"""Gaussian mixtures on the rows of the affinity matrix, chosen by BIC (fig. 3.4 of the thesis)."""

import warnings

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from ..window import Floats

_COVARIANCES = ("full", "diag", "spherical")
_MOST_COMPONENTS = 10
# Floor of a variance, as scikit-learn had it when the thesis was written. With the 1e-6 of today a
# component of a single row is as good as certain, and the largest number of components wins.
_VARIANCE_FLOOR = 1e-3


def best_mixture(affinity: Floats) -> NDArray[np.intp]:
    """Labels intp [N] of the mixture with the smallest Bayesian information criterion.

    1 to 10 components, full, diagonal and spherical covariances, as in fig. 3.4. The thesis finds it
    to choose too many clusters; it is slow as well, since N rows have N dimensions.
    """
    n = len(affinity)
    best, labels = np.inf, np.zeros(n, np.intp)
    for components in range(1, min(n, _MOST_COMPONENTS) + 1 if n > 1 else 1):
        for covariance in _COVARIANCES:
            bic, found = _fit(affinity, components, covariance)
            if bic < best:
                best, labels = bic, found
    return labels


def _fit(rows: Floats, components: int, covariance: str) -> tuple[float, NDArray[np.intp]]:
    model = GaussianMixture(components, covariance_type=covariance, reg_covar=_VARIANCE_FLOOR, random_state=0)
    with warnings.catch_warnings():
        # Fewer distinct rows than components: such a model loses by its BIC.
        warnings.simplefilter("ignore", ConvergenceWarning)
        labels: NDArray[np.intp] = model.fit_predict(rows)
    return float(model.bic(rows)), labels
