"""In the result of a search, out the poses of its bodies over the window, for links to other spaces."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Ints, Stamps
from .assignment import SearchResult
from .procrustes import Body
from .resampling import Frames
from .tracks import Tracks

# rad^-2, information of the prior: a turn that no point fixes (two features, or all in a line) is uncertain
# by a radian.
_FREE_TURN = 1.0


@dataclass(frozen=True)
class Poses:
    """K bodies over F frames, x = R b + t in the axes of the space; the static one is the first.

    Attributes
    ----------
    stamps
        int64 [F], ns, ascending.
    ids
        int64 [K], hypothesis of each body; negative for one without members.
    R, t, posed
        float64 [K, F, 3, 3], float64 [K, F, 3], bool [K, F].
    place_variance, turn_variance
        float64 [K, F]; of a coordinate of the members' centroid, and of a turn about it, rad².
    centre, radius
        float64 [K, 3] body coordinates of the members' centroid, and [K] their root mean square
        distance from it.
    """

    stamps: Stamps
    ids: NDArray[np.int64]
    R: Floats
    t: Floats
    posed: Bools
    place_variance: Floats
    turn_variance: Floats
    centre: Floats
    radius: Floats

    def of(self, bodies: Ints) -> "Poses":
        """Some of the bodies, by index."""
        parts = {f.name: getattr(self, f.name)[bodies] for f in fields(self) if f.name != "stamps"}
        return Poses(self.stamps, **parts)

    def at_rest(self, bodies: Ints) -> "Poses":
        """Poses in which some bodies, by index, rest: they have the poses of the static one.

        What a fit to their members says of their motion is noise.
        """
        found = replace(self, **{f: getattr(self, f).copy() for f in _OF_FRAMES})
        for name in _OF_FRAMES:
            column = getattr(found, name)
            column[bodies] = column[0]
        return found


# What a body has in each frame.
_OF_FRAMES = ("R", "t", "posed", "place_variance", "turn_variance")


def poses_of(tracks: Tracks, frames: Frames, found: SearchResult, ids: NDArray[np.int64]) -> Poses:
    """Collect the poses of all bodies of a search.

    Parameters
    ----------
    ids
        int64 [K], hypotheses of the bodies.
    """
    newest = tracks.newest
    shapes = [
        _shape(body, newest[(found.assignment.labels == k) & tracks.current])
        for k, body in enumerate(found.bodies)
    ]
    variances = [_variances(frames, body) for body in found.bodies]
    return Poses(
        stamps=frames.stamps,
        ids=ids,
        R=np.stack([body.R for body in found.bodies]),
        t=np.stack([body.t for body in found.bodies]),
        posed=np.stack([body.posed for body in found.bodies]),
        place_variance=np.stack([place for place, _ in variances]),
        turn_variance=np.stack([turn for _, turn in variances]),
        centre=np.stack([centre for centre, _ in shapes]),
        radius=np.array([radius for _, radius in shapes]),
    )


def _shape(body: Body, newest: Floats) -> tuple[Floats, float]:
    """Centroid and root mean square radius of the members, in body coordinates."""
    points = newest if body.static else body.template
    if not len(points):
        return np.zeros(3), 0.0
    centre = points.mean(0)
    return centre, float(np.sqrt(((points - centre) ** 2).sum(1).mean()))


def _variances(frames: Frames, body: Body) -> tuple[Floats, Floats]:
    """Variance of the place and of the turn of a fitted pose, [F] each; none where it is static."""
    if body.static:
        return np.zeros(len(frames.stamps)), np.zeros(len(frames.stamps))
    return pose_variances(body.template, frames.w[body.rows], frames.tolerance[body.rows])


def pose_variances(template: Floats, w: Floats, tolerance: Floats) -> tuple[Floats, Floats]:
    """Variance of a least-squares pose: of its place, and of its turn on average over the axes, [F] each.

    With dx = dt + dθ × r, r about the centroid, the information is Σ w/v for dt and
    Σ (w/v) (|r|² I − r rᵀ) for dθ.

    Parameters
    ----------
    template, w, tolerance
        float64 [m, 3], [m, F], [m]: the points, their relative weights and their variance.
    """
    weight = w / tolerance[:, None]
    r = template - template.mean(0)
    moment = (r**2).sum(1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
    information: Ints | Floats = np.einsum("mf,mij->fij", weight, moment) + _FREE_TURN * np.eye(3)
    turn = np.trace(np.linalg.inv(information), axis1=1, axis2=2) / 3
    return 1 / np.maximum(weight.sum(0), 1e-12), turn
