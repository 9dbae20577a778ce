"""What the thesis compares divisive k-means with: spectral clustering (fig. 3.5) and mixtures (fig. 3.4)."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from ..arrays import Floats

# The thesis looks at the first ten eigenvalues.
MAX_EIGENVALUES = 10
_ZERO = 1e-9
COVARIANCES = ("full", "diag", "spherical")
# As many; more components of 50 to 100 trajectories have too few rows each.
_MAX_COMPONENTS = 10
# Floor of a variance, as scikit-learn had it when the thesis was written. With the 1e-6 of today a
# component of a single row is as good as certain, and the largest number of components wins.
_VARIANCE_FLOOR = 1e-3


def cut_spectrum(affinity: Floats, *, normalized: bool) -> NDArray[np.intp]:
    """Labels intp [N], N of 2 or more, by k-means on the first K eigenvectors of the graph Laplacian.

    K is where the gap λ_K+1 − λ_K is largest, and no fewer than the eigenvalues that are 0: so many
    components the graph has. The affinity is float64 [N, N].
    """
    values, vectors = spectrum(affinity, normalized=normalized)
    clusters = count_clusters(values)
    with warnings.catch_warnings():
        # Rows that coincide leave fewer clusters than wanted, which is as it should be.
        warnings.simplefilter("ignore", ConvergenceWarning)
        k_means = KMeans(clusters, n_init=10, random_state=0).fit(vectors[:, :clusters])
    return np.asarray(k_means.labels_, np.intp)


def spectrum(affinity: Floats, *, normalized: bool) -> tuple[Floats, Floats]:
    """Eigenvalues float64 [N] of the graph Laplacian, increasing, and eigenvectors float64 [N, N].

    It is L = D − A, or `normalized` L_norm = I − D⁻¹A.
    """
    n = len(affinity)
    degree = affinity.sum(axis=1)
    # D⁻¹A and D^-½AD^-½ have the same eigenvalues; the second is symmetric.
    scale = 1 / np.sqrt(degree) if normalized else np.ones(n)
    kernel = scale[:, None] * affinity * scale
    laplacian = np.eye(n) - kernel if normalized else np.diag(degree) - affinity
    values, vectors = eigh(laplacian)
    return values, scale[:, None] * vectors


def count_clusters(eigenvalues: Floats) -> int:
    """Count clusters by the largest gap among the first ten of increasing eigenvalues [N]."""
    components = int((eigenvalues < _ZERO * max(eigenvalues[-1], 1.0)).sum())
    gaps = np.diff(eigenvalues[:MAX_EIGENVALUES])
    return max(components, int(gaps.argmax()) + 1)


@dataclass(frozen=True)
class Mixture:
    """One fitted mixture: its number of components, kind of covariances, BIC, and labels intp [N]."""

    components: int
    covariance: str
    bic: float
    labels: NDArray[np.intp]


def best_mixture(affinity: Floats) -> NDArray[np.intp]:
    """Labels intp [N], N of 2 or more, of the mixture with the smallest Bayesian information criterion.

    The thesis finds it to choose too many clusters; it is slow as well, since N rows have N dimensions.
    """
    return min(mixtures(affinity), key=lambda mixture: mixture.bic).labels


def mixtures(affinity: Floats) -> Iterator[Mixture]:
    """Fit 1 to 10 components with full, diagonal and spherical covariances, as in fig. 3.4.

    The affinity is float64 [N, N], N of 2 or more.
    """
    for components in range(1, min(len(affinity), _MAX_COMPONENTS) + 1):
        for covariance in COVARIANCES:
            model = GaussianMixture(
                components, covariance_type=covariance, reg_covar=_VARIANCE_FLOOR, random_state=0
            )
            with warnings.catch_warnings():
                # Fewer distinct rows than components: such a model loses by its BIC.
                warnings.simplefilter("ignore", ConvergenceWarning)
                labels: NDArray[np.intp] = model.fit_predict(affinity)
            yield Mixture(components, covariance, float(model.bic(affinity)), labels)
