"""The comparator of fits: a screw fitted to the same states by GTSAM, with the true noise.

GTSAM is not a dependency of the project: ``pip install gtsam``.
"""

from importlib.util import find_spec
from typing import Any

import numpy as np

from comotion.arrays import Floats
from comotion.joints.models import Model, positions
from comotion.joints.states import States, turned

_STEP = 1e-6
# Weak priors, which only hold what the states leave open: the position 0, and the point along the axis.
_POSITION_SIGMA, _POINT_SIGMA = 1e-3, 10.0


def available() -> bool:
    """Whether GTSAM is installed."""
    return find_spec("gtsam") is not None


def fit_screw(states: States, start: Model, sigmas: tuple[float, float]) -> tuple[Floats, Floats]:
    """Axis and point of a hinge or slide by Levenberg-Marquardt on a factor graph.

    Parameters
    ----------
    states
        n states.
    start
        A first guess of the kind to be fitted.
    sigmas
        One-sigma noise of turn (rad) and place.
    """
    import gtsam

    axis, base, point = (gtsam.symbol(letter, 0) for letter in "atc")
    hinge = start.kind == "revolute"
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(axis, gtsam.Unit3(start.u))
    values.insert(base, gtsam.Pose3(gtsam.Rot3(start.R0), start.p0))
    if hinge:
        values.insert(point, np.asarray(start.c))
        prior = gtsam.noiseModel.Isotropic.Sigma(3, _POINT_SIGMA)
        graph.add(gtsam.PriorFactorPoint3(point, np.asarray(start.c), prior))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat(sigmas, 3))
    for k, q in enumerate(positions(start, states).tolist()):
        position = gtsam.symbol("q", k)
        values.insert(position, np.array([q]))
        keys = [axis, base, position, *([point] if hinge else [])]
        graph.add(gtsam.CustomFactor(noise, keys, _Factor(states.R[k], states.p[k])))
        if k == 0:
            held = gtsam.noiseModel.Isotropic.Sigma(1, _POSITION_SIGMA)
            graph.add(gtsam.PriorFactorVector(position, np.array([q]), held))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    return found.atUnit3(axis).point3(), found.atPoint3(point) if hinge else start.p0


class _Factor:
    """Residual of one state (turn, place), with derivatives by differences."""

    def __init__(self, R: Floats, p: Floats) -> None:
        self._R, self._p = R, p

    def __call__(self, factor: Any, values: Any, jacobians: list[Floats] | None) -> Floats:
        axis, base, position, *rest = factor.keys()
        u, pose, q = values.atUnit3(axis), values.atPose3(base), values.atVector(position)
        c = values.atPoint3(rest[0]) if rest else None
        here = self._residual(u, pose, q, c)
        if jacobians is None:
            return here

        def differences(moved: list[tuple[Any, Any, Floats, Any]]) -> Floats:
            return np.column_stack([(self._residual(*one) - here) / _STEP for one in moved])

        jacobians[0] = differences([(u.retract(_STEP * e), pose, q, c) for e in np.eye(2)])
        jacobians[1] = differences([(u, pose.retract(_STEP * e), q, c) for e in np.eye(6)])
        jacobians[2] = differences([(u, pose, q + _STEP, c)])
        if c is not None:
            jacobians[3] = differences([(u, pose, q, c + _STEP * e) for e in np.eye(3)])
        return here

    def _residual(self, axis: Any, pose: Any, q: Floats, c: Floats | None) -> Floats:
        import gtsam

        u, R, p = axis.point3(), pose.rotation().matrix(), pose.translation()
        if c is None:
            place = p + q[0] * u
        else:
            E = turned(np.eye(3), q[0] * u)
            R, place = E @ R, c + E @ (p - c)
        return np.concatenate([gtsam.Rot3.Logmap(gtsam.Rot3(self._R @ R.T)), self._p - place])
