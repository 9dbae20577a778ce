"""States of one body against another, with their information."""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Bools, Floats, Stamps, inverses
from ..partition import BodyMotion
from ..rigid.kernels.rotation import rotation_matrix, rotation_vectors

# Errors of poses that last: patches drift, features come and go, bodies bend. A second of frames has one such
# error. Its variance is that of a frame, so many times: on links of the workcell's arm it was measured to be
# 1 to 3 times, for 1 to 2 s, on its door half of it. What bends adds this share of the smaller body's radius,
# and so many rad.
_LASTING = 1.0
_SLOW_SHARE = 0.01
_SLOW_TURN = 0.004
_SLOW_SECONDS = 1.0


@dataclass(frozen=True)
class States:
    """n states of a child against its parent, in the parent's axes.

    Attributes
    ----------
    stamps
        int64 [n], ns.
    R, p
        float64 [n, 3, 3], orientation of the child; [n, 3], place of a point of the child, its centroid.
    information
        float64 [n, 6, 6], inverse covariance of (turn, place), the turn in the parent's axes.
    """

    stamps: Stamps
    R: Floats
    p: Floats
    information: Floats

    def __len__(self) -> int:
        return len(self.stamps)

    @cached_property
    def roots(self) -> Floats:
        """W with Wᵀ W the information, upper triangles, float64 [n, 6, 6]."""
        return np.ascontiguousarray(np.linalg.cholesky(self.information).transpose(0, 2, 1))

    def of(self, chosen: Bools | slice) -> "States":
        """Some of the states."""
        return States(*(getattr(self, f.name)[chosen] for f in fields(self)))

    @classmethod
    def empty(cls) -> "States":
        """No states."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 6, 6)))

    @classmethod
    def joined(cls, parts: list["States"]) -> "States":
        """States one after the other."""
        return cls(*(np.concatenate([getattr(s, f.name) for s in parts]) for f in fields(cls)))


def averaged(states: States) -> States:
    """The mean of every two successive states, which says the same for half the work.

    A last one without company is left out.
    """
    first, second = states.of(slice(0, len(states) - 1, 2)), states.of(slice(1, None, 2))
    if not len(first):
        return states
    return States(
        second.stamps,
        turned(first.R, 0.5 * turns_between(second.R, first.R)),
        (first.p + second.p) / 2,
        first.information + second.information,
    )


def relative_states(parent: BodyMotion, child: BodyMotion, point: Floats) -> States:
    """States of a child against its parent over the frames in which both have a pose.

    Parameters
    ----------
    parent, child
        Motions over the same frames.
    point
        float64 [3], the point of the child that the place is of, in the child's axes.

    Notes
    -----
    With errors dθ and dt about its centroid of each pose, the relative turn errs by dθc - dθp, and the
    place by dtc - dtp - dθp × l, where l leads from the parent's centroid to the point.
    """
    both = parent.posed & child.posed
    Rp, Rc = parent.R[both], child.R[both]
    inverse = Rp.transpose(0, 2, 1)
    R = inverse @ Rc
    p = np.einsum("nij,nj->ni", inverse, Rc @ point + child.t[both] - parent.t[both])
    frames = _frames_of_an_error(parent, both)
    lever = skew(p - parent.centre)
    arm = skew(np.einsum("nij,j->ni", R, point - child.centre))
    turn_c = R @ child.turn_covariance[both] @ R.transpose(0, 2, 1)
    turn_p = parent.turn_covariance[both]
    covariance = np.zeros((len(R), 6, 6))
    covariance[:, :3, :3] = turn_c + turn_p
    covariance[:, 3:, :3] = -lever @ turn_p - arm @ turn_c
    covariance[:, :3, 3:] = covariance[:, 3:, :3].transpose(0, 2, 1)
    covariance[:, 3:, 3:] = lever @ turn_p @ lever.transpose(0, 2, 1) + arm @ turn_c @ arm.transpose(0, 2, 1)
    place = parent.place_variance[both] + child.place_variance[both]
    covariance[:, 3:, 3:] += place[:, None, None] * np.eye(3)
    covariance *= 1 + _LASTING * frames
    covariance += frames * _bending(parent, child)
    return States(parent.stamps[both], R, p, inverses(covariance))


def _frames_of_an_error(body: BodyMotion, posed: Bools) -> float:
    """How many frames share one lasting error: the variance that it adds to each is so many times its own."""
    seconds = max((body.stamps[-1] - body.stamps[0]) * 1e-9, 1e-9)
    return max(float(posed.sum() * _SLOW_SECONDS / seconds), 1.0)


def _bending(parent: BodyMotion, child: BodyMotion) -> Floats:
    """Variance of the lasting error of bodies that bend, float64 [6, 6]."""
    sizes = [body.radius for body in (parent, child) if not body.static]
    place = _SLOW_SHARE * min(sizes, default=0.0)
    return np.asarray(np.diag([_SLOW_TURN**2] * 3 + [place**2] * 3), np.float64)


def skew(v: Floats) -> Floats:
    """Matrices [v]x of vectors [n, 3], [n, 3, 3]."""
    found = np.zeros((len(v), 3, 3))
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    found[:, 1, 0], found[:, 2, 0], found[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return found


def turned(R: Floats, by: Floats) -> Floats:
    """Rotations [n, 3, 3] turned by rotation vectors [n, 3] or [3] of the outer axes."""
    found = rotation_matrix(by) if by.ndim == 1 else Rotation.from_rotvec(by).as_matrix()
    return np.asarray(found @ R)


def turns_between(R: Floats, reference: Floats) -> Floats:
    """Rotation vectors [n, 3], in the outer axes, that take reference rotations to R."""
    return rotation_vectors(np.ascontiguousarray(R @ np.swapaxes(reference, -1, -2)))


def quantiles(values: Floats, shares: tuple[float, ...]) -> list[float]:
    """Quantiles of n > 0 values by linear interpolation, as ``np.quantile`` at a tenth of its cost."""
    last = len(values) - 1
    wanted = np.array(shares) * last
    return [float(one) for one in np.interp(wanted, np.arange(last + 1), np.sort(values))]
