"""Which trajectories may form a body: distance variance proposes, rigid motion judges."""

import numpy as np
from scipy.cluster.hierarchy import linkage
from scipy.spatial.distance import squareform

from ..arrays import Floats, Ints
from .frames import Frames
from .sampling import deviation_from, distance_deviation

# Cuts of the dendrograms, in units of a pair's tolerance: from as rigid as the noise allows to loose.
CUTS = (1.0, 1.5, 2.0, 3.0, 4.5, 6.0)
# A pair that shares no frames is neither near nor far.
_UNKNOWN = 3.0
_METHODS = ("average", "complete")


def propose(frames: Frames, rows: Ints) -> list[Ints]:
    """Distinct clusters of two rows or more, by average and complete linkage at several cuts.

    The distance of two rows is the standard deviation of their distance (3.3) over the frames, in
    units of their common tolerance sqrt(v_i + v_j): one scale for each pair instead of one γ.
    """
    if len(rows) < 2:
        return []
    condensed = squareform(_deviation(frames, rows), checks=False)
    found: dict[bytes, Ints] = {}
    for method in _METHODS:
        for members in _clusters(linkage(condensed, method)):
            found.setdefault(members.tobytes(), members)
    return [rows[members] for members in found.values()]


def _clusters(tree: Floats) -> list[Ints]:
    """Clusters of two or more at any of the cuts, ascending indices.

    A node of the dendrogram is one at every cut from its own height up to that of its parent.
    """
    count = len(tree) + 1
    height = np.append(tree[:, 2], np.inf)
    parent = np.full(2 * count - 1, len(tree))
    children = tree[:, :2].astype(np.intp)
    parent[children] = np.arange(len(tree))[:, None]
    above = height[parent[count:]]
    cuts = np.array(CUTS)[:, None]
    cut = ((height[:-1] <= cuts) & (cuts < above)).any(0)
    members: list[Ints] = [np.array([i]) for i in range(count)]
    for left, right in children.tolist():
        members.append(np.concatenate([members[left], members[right]]))
    return [np.sort(members[count + j]) for j in np.flatnonzero(cut).tolist()]


def _deviation(frames: Frames, rows: Ints) -> Floats:
    """Normalised distance deviation, float64 [n, n]; rows of one trajectory are at zero."""
    tolerance = frames.tolerance[rows]
    deviation = distance_deviation(frames.y[rows], frames.w[rows])
    deviation = deviation / np.sqrt(tolerance[:, None] + tolerance[None])
    owner = frames.owner[rows]
    deviation[owner[:, None] == owner[None]] = 0.0
    return np.asarray(np.nan_to_num(deviation, nan=_UNKNOWN))


def adopt(frames: Frames, bodies: list[Ints], strays: Ints) -> list[Ints]:
    """Each stray trajectory's rows with those of the body it keeps its distance from best.

    A pair turns freely about its axis, so that its motion says nothing of a third member: only a fit
    to all three can tell that it belongs.

    Parameters
    ----------
    bodies
        Rows of each body.
    strays
        intp [n], trajectories that belong to none.
    """
    if not bodies:
        return []
    found = []
    of = np.repeat(np.arange(len(bodies)), [len(body) for body in bodies])
    rows = np.concatenate(bodies)
    first = np.argsort(frames.owner, kind="stable")
    first = first[np.searchsorted(frames.owner[first], strays)]
    for one, row in zip(strays.tolist(), first.tolist(), strict=True):
        deviation = deviation_from(frames.y, frames.w, row, rows)
        deviation /= np.sqrt(frames.tolerance[row] + frames.tolerance[rows])
        distances = np.bincount(of, np.nan_to_num(deviation, nan=_UNKNOWN)) / np.bincount(of)
        found.append(np.union1d(bodies[int(np.argmin(distances))], frames.rows_of(np.array([one]))))
    return found
