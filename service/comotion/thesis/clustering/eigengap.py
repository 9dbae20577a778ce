"""Spectral clustering with as many clusters as the eigengap suggests (fig. 3.5 of the thesis)."""

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning

from ...arrays import Floats

# The thesis looks at the first ten eigenvalues.
MOST_EIGENVALUES = 10
_ZERO = 1e-9


def cut_spectrum(affinity: Floats, *, normalized: bool) -> NDArray[np.intp]:
    """Labels intp [N] by k-means on the first K eigenvectors of the graph Laplacian.

    K is where the gap λ_K+1 − λ_K is largest, and no fewer than the eigenvalues that are 0: so many
    components the graph has.

    Parameters
    ----------
    affinity
        float64 [N, N].
    normalized
        L_norm = I − D⁻¹A instead of L = D − A.
    """
    n = len(affinity)
    if n < 2:
        return np.zeros(n, np.intp)
    values, vectors = spectrum(affinity, normalized=normalized)
    clusters = count_clusters(values)
    return _assign(vectors[:, :clusters], clusters)


def spectrum(affinity: Floats, *, normalized: bool) -> tuple[Floats, Floats]:
    """Eigenvalues float64 [N] of the graph Laplacian, increasing, and eigenvectors float64 [N, N].

    Parameters
    ----------
    affinity, normalized
        As in :func:`cut_spectrum`.
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
    gaps = np.diff(eigenvalues[:MOST_EIGENVALUES])
    return max(components, int(gaps.argmax()) + 1)


def _assign(embedding: Floats, clusters: int) -> NDArray[np.intp]:
    with warnings.catch_warnings():
        # Rows that coincide leave fewer clusters than asked for, which is as it should be.
        warnings.simplefilter("ignore", ConvergenceWarning)
        labels: NDArray[np.intp] = KMeans(clusters, n_init=10, random_state=0).fit_predict(embedding)
    return labels
