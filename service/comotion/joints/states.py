"""States of one body against another, with their information, and the few that outlive the window."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats, Stamps, Table, inverses
from ..geometry.body import pose_columns
from ..geometry.rotation import rotation_vectors
from ..partition import BodyMotion

# Errors of poses that last: patches drift, features come and go, bodies bend. A second of frames has one such
# error. Its variance is that of a frame, so many times: on links of the workcell's arm it was measured to be
# 1 to 3 times, for 1 to 2 s, on its door half of it. What bends adds this share of the smaller body's radius,
# and so many rad.
_LASTING = 1.0
_SLOW_SHARE = 0.01
_SLOW_TURN = 0.004
_SLOW_SECONDS = 1.0
# rad, and share of the child's radius, by which states are as different.
_ALIKE_TURN, _ALIKE_SHIFT = 0.04, 0.1
# Key states of a pair.
_MAX_STATES = 40


@dataclass(frozen=True)
class States(Table):
    """n states of a child against its parent, in the parent's axes."""

    stamps: Stamps
    """int64 [n], ns."""
    R: Floats
    p: Floats
    """float64 [n, 3, 3], orientation of the child; [n, 3], place of a point of the child, its centroid."""
    information: Floats
    """float64 [n, 6, 6], inverse covariance of (turn, place), the turn in the parent's axes."""

    @cached_property
    def roots(self) -> Floats:
        """W with Wᵀ W the information, upper triangles, float64 [n, 6, 6]."""
        return np.ascontiguousarray(np.linalg.cholesky(self.information).transpose(0, 2, 1))

    @classmethod
    def empty(cls) -> "States":
        """No states."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 6, 6)))


def averaged(states: States) -> States:
    """The mean of every two successive states, which says the same for half the work.

    A last one without company is left out.
    """
    first, second = states.of(slice(0, len(states) - 1, 2)), states.of(slice(1, None, 2))
    if not len(first):
        return states
    return States(
        second.stamps,
        Rotation.from_rotvec(0.5 * turns_between(second.R, first.R)).as_matrix() @ first.R,
        (first.p + second.p) / 2,
        first.information + second.information,
    )


def relative_states(parent: BodyMotion, child: BodyMotion, point: Floats) -> States:
    """States of a child against its parent over the frames in which both have a pose.

    Their motions are over the same frames; the place is that of a `point` float64 [3] in the child's axes.
    With errors dθ and dt about its centroid of each pose, the relative turn errs by dθc - dθp, and the
    place by dtc - dtp - dθp × l, where l leads from the parent's centroid to the point.
    """
    both = parent.posed & child.posed
    Rp, Rc = parent.R[both], child.R[both]
    inverse = Rp.transpose(0, 2, 1)
    R = inverse @ Rc
    p = np.einsum("nij,nj->ni", inverse, Rc @ point + child.t[both] - parent.t[both])
    arm = skew(np.einsum("nij,j->ni", R, point - child.centre))
    by_parent = np.concatenate([np.broadcast_to(np.eye(3), R.shape), -skew(p - parent.centre)], 1)
    by_child = np.concatenate([R, -arm @ R], 1)
    covariance = by_parent @ parent.turn_covariance[both] @ by_parent.transpose(0, 2, 1)
    covariance += by_child @ child.turn_covariance[both] @ by_child.transpose(0, 2, 1)
    place = parent.place_variance[both] + child.place_variance[both]
    covariance[:, 3:, 3:] += place[:, None, None] * np.eye(3)
    # So many frames share one lasting error, whose variance adds as many times that of one to each.
    seconds = max(float(parent.stamps[-1] - parent.stamps[0]) * 1e-9, 1e-9)
    frames = max(float(both.sum()) * _SLOW_SECONDS / seconds, 1.0)
    radius = min((body.radius for body in (parent, child) if not body.static), default=0.0)
    bent = np.repeat([_SLOW_TURN**2, (_SLOW_SHARE * radius) ** 2], 3)
    covariance = (1 + _LASTING * frames) * covariance + frames * np.diag(bent)
    return States(parent.stamps[both], R, p, inverses(covariance))


def skew(v: Floats) -> Floats:
    """Matrices [v]x of vectors [n, 3], [n, 3, 3]."""
    return -pose_columns(v, 3)[:, :, :3]


def turns_between(R: Floats, reference: Floats) -> Floats:
    """Rotation vectors [n, 3], in the outer axes, that take reference rotations to R."""
    return rotation_vectors(np.ascontiguousarray(R @ np.swapaxes(reference, -1, -2)))


def key_states(states: States, radius: float) -> States:
    """At most :data:`_MAX_STATES` of the states, those that differ most; of two alike the later one remains.

    `radius` is the child's, in the unit of the space.
    """
    while len(states) > _MAX_STATES:
        # 3 - tr(R1 R2^T) = 2 (1 - cos): its root is the chord of the turn.
        flat = states.R.reshape(-1, 9)
        turn = np.sqrt(np.maximum(3 - flat @ flat.T, 0)) / _ALIKE_TURN
        shift = np.linalg.norm(states.p[:, None] - states.p, axis=2) / max(_ALIKE_SHIFT * radius, 1e-9)
        apart = np.maximum(turn, shift)
        np.fill_diagonal(apart, np.inf)
        states = states.of(np.arange(len(states)) != apart.min(1).argmin())
    return states
