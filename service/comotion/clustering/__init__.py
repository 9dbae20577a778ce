"""From an affinity matrix to clusters: the thesis's choice and the alternatives it compares."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..config import Clustering
from ..window import Floats
from .divisive_kmeans import divide
from .eigengap import cut_spectrum
from .gmm_bic import best_mixture

Labels = NDArray[np.intp]
ClusterFunction = Callable[[Floats], Labels]


def make_clustering(name: Clustering, stop_affinity: float) -> ClusterFunction:
    """Clustering by its name in the configuration.

    What it returns maps an affinity matrix, float64 [N, N] in 0..1 with ones on the diagonal, to
    labels, intp [N]: 0, 1, 2... in the order in which clusters first appear.
    """
    known: dict[Clustering, ClusterFunction] = {
        "divisive-kmeans": partial(divide, stop_affinity=stop_affinity),
        "gmm-bic": best_mixture,
        "eigengap": partial(cut_spectrum, normalized=False),
        "eigengap-normalized": partial(cut_spectrum, normalized=True),
    }
    choice = known[name]
    return lambda affinity: by_appearance(choice(affinity))


def by_appearance(labels: Labels) -> Labels:
    """Rename labels to 0, 1, 2... in the order in which they first appear."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]
