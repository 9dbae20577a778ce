"""Compiled: in states and a joint, out the joint that fits them best."""

import numpy as np

from ..arrays import Floats
from ..compiled import compiled
from ..rigid.kernels.rotation import rotation_matrix, rotation_vectors

FIXED, PRISMATIC, REVOLUTE = 0, 1, 2
UNKNOWNS = 10
"""Turn of R0, shift of p0, shift of c and turn of the axis, of the last two the parts across the axis."""
HEAVY = 30.0
"""Degrees of freedom of Student's t: residuals beyond some five standard deviations count less and less."""
# The step, in standard deviations squared, below which a fit has converged.
_SETTLED = 1e-2
# A direction below this squared length, in standard deviations per unit, does not determine a position.
_NO_DIRECTION = 1e-12


@compiled()
def fit_joint(
    R: Floats,
    p: Floats,
    W: Floats,
    kind: int,
    R0: Floats,
    frame: Floats,
    q: Floats,
    prior: Floats,
    steps: int,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit a joint to states by Gauss-Newton, the positions eliminated; in place.

    Parameters
    ----------
    R, p, W
        float64 [n, 3, 3], [n, 3] and [n, 6, 6], states, and roots of their information (Wᵀ W).
    kind
        :data:`FIXED`, :data:`PRISMATIC` or :data:`REVOLUTE`.
    R0, frame
        float64 [3, 3] and [5, 3], the joint: orientation; place, axis, point of the axis, zero where it does
        not turn, and room for two unit vectors across the axis.
    q
        float64 [n], positions.
    prior
        float64 [4], where the point of a hinge is expected, and the inverse variance of that.
    steps
        At most.

    Returns
    -------
    left, residual, strength, slope
        float64 [10, 10], information on the unknowns; [n, 6], whitened residuals; [n], information on each
        position; [n, 11], the step of each position is the last of them less the product of the others with
        the step.
    """
    left, right = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    residual, strength, slope = np.zeros((len(q), 6)), np.zeros(len(q)), np.zeros((len(q), UNKNOWNS + 1))
    settled = False
    for k in range(steps + 1):
        left[:], right[:] = 0.0, 0.0
        _span_across(frame)
        _normal_equations(R, p, W, kind, R0, frame, q, left, right, residual, strength, slope)
        _constrain(kind, frame, prior, left, right)
        if settled or k == steps:
            break
        step = np.linalg.solve(left, right)
        gain, misfit = 0.0, 0.0
        for n in range(len(q)):
            q[n] += slope[n, UNKNOWNS]
            for a in range(UNKNOWNS):
                q[n] -= slope[n, a] * step[a]
            for i in range(6):
                misfit += residual[n, i] * residual[n, i] / residual.size
        _move(kind, R0, frame, step)  # type: ignore[arg-type]
        for a in range(UNKNOWNS):
            for b in range(UNKNOWNS):
                gain += step[a] * left[a, b] * step[b]
        # Where the joint does not fit, a standard deviation is more than the states say.
        settled = gain < _SETTLED * max(misfit, 1.0)
    return left, residual, strength, slope


@compiled()
def _normal_equations(
    R: Floats,
    p: Floats,
    W: Floats,
    kind: int,
    R0: Floats,
    frame: Floats,
    q: Floats,
    left: Floats,
    right: Floats,
    residual: Floats,
    strength: Floats,
    slope: Floats,
) -> None:
    """Normal equations of a step, as in :func:`fit_joint`; `left` and `right` [10] are zero before."""
    u, c = frame[1], frame[2]
    J, white = np.zeros((6, UNKNOWNS + 2)), np.zeros((6, UNKNOWNS + 2))
    E, turn = np.eye(3), np.zeros((1, 3, 3))
    d, moved, wide = frame[0] - c, np.zeros(3), np.zeros((3, 3))
    for n in range(len(q)):
        if kind == REVOLUTE:
            E = rotation_matrix(q[n] * u)
        _apply(E, d, moved)
        _turn_left(R[n], E, R0, wide, turn[0])
        J[:] = 0.0
        _derivatives(kind, frame, E, d, moved, q[n], J)
        J[:3, UNKNOWNS + 1] = rotation_vectors(turn)[0]
        for i in range(3):
            J[3 + i, UNKNOWNS + 1] = p[n, i] - c[i] - moved[i] - (q[n] * u[i] if kind == PRISMATIC else 0.0)
        _whiten(W[n], J, white)
        squared = 0.0
        for i in range(6):
            residual[n, i] = white[i, UNKNOWNS + 1]
            squared += residual[n, i] * residual[n, i]
        _eliminate(white, kind, n, strength, slope)
        _add(white, 1 / (1 + squared / HEAVY), left, right)
    for a in range(UNKNOWNS):
        left[:a, a] = left[a, :a]


@compiled()
def _span_across(frame: Floats) -> None:
    """Two unit vectors across the axis, in place.

    Duff et al. (2017), "Building an orthonormal basis, revisited".
    """
    x, y, z = frame[1]
    sign = 1.0 if z >= 0 else -1.0
    a = -1 / (sign + z)
    b = x * y * a
    frame[3, 0], frame[3, 1], frame[3, 2] = 1 + sign * x * x * a, sign * b, -sign * x
    frame[4, 0], frame[4, 1], frame[4, 2] = b, sign + y * y * a, -y


@compiled()
def _constrain(kind: int, frame: Floats, prior: Floats, left: Floats, right: Floats) -> None:
    """Hold what the kind does not have, and the position 0 along the joint, in place."""
    scale = 1e-9
    for a in range(UNKNOWNS):
        scale += left[a, a] / UNKNOWNS
    used = 6 if kind != REVOLUTE else UNKNOWNS
    for a in range(used, 8 if kind == PRISMATIC else UNKNOWNS):
        left[a, a] += scale
    gauge = np.zeros(6)
    if kind == PRISMATIC:
        gauge[3:] = frame[1]
    elif kind == REVOLUTE:
        gauge[:3] = frame[1]
        _add_cross(frame[1], frame[0] - frame[2], 1.0, gauge[3:])
    for a in range(6):
        for b in range(6):
            left[a, b] += scale * gauge[a] * gauge[b]
    for a in range(UNKNOWNS):
        left[a, a] += 1e-9 * scale
    for k in range(2 if kind == REVOLUTE else 0):
        left[6 + k, 6 + k] += prior[3]
        for i in range(3):
            right[6 + k] += prior[3] * frame[3 + k, i] * (prior[i] - frame[2, i])
        # An axis that no turn determines stays where it is.
        left[8 + k, 8 + k] += 1.0


@compiled()
def _move(kind: int, R0: Floats, frame: Floats, step: Floats) -> None:
    """Move a joint by a step of its unknowns, in place."""
    bend, turned = np.zeros(3), np.zeros(3)
    turn = rotation_matrix(step[:3])
    for j in range(3):
        _apply(turn, R0[:, j], turned)
        R0[:, j] = turned
        frame[0, j] += step[3 + j]
        bend[j] = frame[3, j] * step[8] + frame[4, j] * step[9]
    if kind == FIXED:
        return
    length = np.sqrt(bend[0] ** 2 + bend[1] ** 2 + bend[2] ** 2)
    # Beyond a radian the equations are not linear.
    _apply(rotation_matrix(bend / max(1.0, length)), frame[1], turned)
    frame[1] = turned
    frame[2] += frame[3] * step[6] + frame[4] * step[7]


@compiled()
def rotation_matrices(v: Floats) -> Floats:
    """Rotations by vectors [n, 3], float64 [n, 3, 3]."""
    found = np.zeros((len(v), 3, 3))
    for n in range(len(v)):
        found[n] = rotation_matrix(v[n])
    return found


@compiled()
def _turn_left(R: Floats, E: Floats, R0: Floats, wide: Floats, found: Floats) -> None:
    """R (E R0)^T, in place."""
    for i in range(3):
        for j in range(3):
            wide[i, j] = E[i, 0] * R0[0, j] + E[i, 1] * R0[1, j] + E[i, 2] * R0[2, j]
    for i in range(3):
        for j in range(3):
            found[i, j] = R[i, 0] * wide[j, 0] + R[i, 1] * wide[j, 1] + R[i, 2] * wide[j, 2]


@compiled()
def _whiten(W: Floats, J: Floats, found: Floats) -> None:
    """W J, in place; W is an upper triangle."""
    found[:] = 0.0
    for i in range(6):
        for j in range(i, 6):
            for k in range(UNKNOWNS + 2):
                found[i, k] += W[i, j] * J[j, k]


@compiled()
def _apply(E: Floats, v: Floats, found: Floats) -> None:
    """E v, in place."""
    for i in range(3):
        found[i] = E[i, 0] * v[0] + E[i, 1] * v[1] + E[i, 2] * v[2]


@compiled()
def _add_cross(a: Floats, b: Floats, factor: float, found: Floats) -> None:
    """Add a factor of a x b, in place."""
    found[0] += factor * (a[1] * b[2] - a[2] * b[1])
    found[1] += factor * (a[2] * b[0] - a[0] * b[2])
    found[2] += factor * (a[0] * b[1] - a[1] * b[0])


@compiled()
def _derivatives(kind: int, frame: Floats, E: Floats, d: Floats, moved: Floats, q: float, J: Floats) -> None:
    """Derivatives of a state by the unknowns and, next to last, by the position, in columns; zero before."""
    u, turned, arm = frame[1], np.zeros(3), np.zeros(3)
    J[:3, :3] = J[3:, 3:6] = E
    if kind == PRISMATIC:
        J[3:, UNKNOWNS] = u
    elif kind == REVOLUTE:
        J[:3, UNKNOWNS] = u
        _add_cross(u, moved, 1.0, J[3:, UNKNOWNS])
    for k in range(2):
        across = frame[3 + k]
        if kind == PRISMATIC:
            _add_cross(across, u, q, J[3:, 8 + k])
        elif kind == REVOLUTE:
            _apply(E, across, turned)
            for i in range(3):
                J[i, 8 + k] = J[3 + i, 6 + k] = across[i] - turned[i]
            arm[:] = 0.0
            _add_cross(across, d, 1.0, arm)
            _apply(E, arm, turned)
            for i in range(3):
                J[3 + i, 8 + k] = -turned[i]
            _add_cross(across, moved, 1.0, J[3:, 8 + k])


@compiled()
def _eliminate(white: Floats, kind: int, n: int, strength: Floats, slope: Floats) -> None:
    """Take out of whitened columns, of derivatives and residual, what the position explains, in place."""
    share = np.zeros(UNKNOWNS + 2)
    strength[n] = _NO_DIRECTION
    slope[n] = 0.0
    if kind == FIXED:
        return
    for i in range(6):
        along = white[i, UNKNOWNS]
        strength[n] += along * along
        for k in range(UNKNOWNS + 2):
            share[k] += along * white[i, k]
    for k in range(UNKNOWNS + 2):
        share[k] /= strength[n]
    slope[n, :UNKNOWNS], slope[n, UNKNOWNS] = share[:UNKNOWNS], share[UNKNOWNS + 1]
    for i in range(6):
        along = white[i, UNKNOWNS]
        for k in range(UNKNOWNS + 2):
            white[i, k] -= share[k] * along


@compiled()
def _add(white: Floats, weight: float, left: Floats, right: Floats) -> None:
    """Add a state to the equations, of `left` its lower triangle, in place."""
    for i in range(6):
        for a in range(UNKNOWNS):
            one = weight * white[i, a]
            right[a] += one * white[i, UNKNOWNS + 1]
            if one == 0.0:  # the kind has no such unknown
                continue
            for b in range(a + 1):
                left[a, b] += one * white[i, b]
