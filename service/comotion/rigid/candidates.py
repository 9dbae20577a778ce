"""Candidates for new bodies: clusters of rows that move alike (step 5)."""

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from comotion_schemas.types import symmetric

from ..arrays import Bools, Floats, Ints
from ..geometry.frames import Frames
from ..partition import NO_HYPOTHESIS
from .kernels.distances import distance_deviation
from .subset import Scene

# Cuts of the dendrogram, in tolerances of a pair, from as rigid as the noise allows to loose; chosen on the
# scenes of docs/research/accuracy.md.
CUTS = (1.0, 2.0, 4.5, 10.0, 20.0)


def cluster_rows(scene: Scene, unexplained: Bools) -> list[Ints]:
    """Rows of every cluster that may be a new body.

    A cluster of explained members of one hypothesis is left out: it would only split that hypothesis. So is
    all of one that moves.

    Parameters
    ----------
    unexplained
        bool [N], trajectories that no hypothesis explains.
    """
    frames, candidates = scene.frames, []
    searched = frames.rows_of(frames.current & scene.judged)
    known, explained = scene.hypotheses[frames.owner], ~unexplained[frames.owner]
    for rows in clusters(frames, searched):
        of = known[rows]
        is_one = of[0] != NO_HYPOTHESIS and (of == of[0]).all()
        is_all = of[0] != scene.static and len(rows) == np.count_nonzero(known[searched] == of[0])
        if not (is_one and (is_all or explained[rows].all())):
            candidates.append(rows)
    return candidates


def clusters(frames: Frames, rows: Ints) -> list[Ints]:
    """Clusters of two rows or more, by average linkage at several cuts.

    The distance of two rows is the standard deviation of their distance in space over the frames (the root
    of (3.3)), in units of their common tolerance along the line between them. So each pair has its own scale,
    where the thesis has one gamma for all.

    Parameters
    ----------
    rows
        intp [n], rows to cluster.
    """
    if len(rows) < 2:
        return []
    tree = linkage(squareform(_normalised_deviation(frames, rows), checks=False), "average")
    found: dict[bytes, Ints] = {}
    for cut in CUTS:
        names = fcluster(tree, cut, "distance")
        for members in (rows[names == name] for name in range(1, names.max() + 1)):
            found |= {members.tobytes(): members} if len(members) > 1 else {}
    return list(found.values())


def _normalised_deviation(frames: Frames, rows: Ints) -> Floats:
    """Deviation of distances in tolerances, float64 [n, n]; rows of one trajectory are at zero."""
    covariance = np.linalg.inv(symmetric(frames.metric[rows])) * frames.tolerance[rows, None, None]
    deviation = distance_deviation(frames.y[rows], frames.w[rows], covariance[:, *np.triu_indices(3)])
    owner = frames.owner[rows]
    deviation[owner[:, None] == owner[None]] = 0.0
    # A pair that shares no frames is neither near nor far: in the middle of the cuts.
    return np.asarray(np.nan_to_num(deviation, nan=CUTS[len(CUTS) // 2]))
