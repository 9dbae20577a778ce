"""The thesis method with 2-means as everybody has it, for what our own splits cost or gain."""

import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion.partition import Method, SpaceSpec
from comotion.thesis.clustering import Clusters, by_appearance
from comotion.thesis.method import ThesisMethod

from ..bench.straightforward import divide


class ReferenceFusion(Fusion):
    """Fusion of which every space is split by scikit-learn's 2-means, the best of ten random starts."""

    def make_method(self, spec: SpaceSpec) -> Method:
        """Build the thesis method with the other split."""
        return ThesisMethod(self.config, spec, lambda affinity, _: _split(affinity, self.config))


def _split(affinity: NDArray[np.float32], config: FusionConfig) -> Clusters:
    dense = affinity.astype(float)
    labels = by_appearance(divide(dense, config.thesis.stop_affinity))
    # Confidence is no part of what is compared.
    return Clusters(labels, dense.mean(axis=1))
