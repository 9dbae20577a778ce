"""Joints of an update as rows of text, plain values, and lines to draw. Pure."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas import Hypothesis, HypothesisUpdate, Joint
from comotion_schemas.naming import Names, joint_words
from comotion_schemas.rigid import three


@dataclass(frozen=True)
class JointRow:
    """One joint as text: `position` (± one-sigma), `rate` and `range` in `unit`, degrees for hinges.

    `words`: kind and range in words.
    """

    parent: int
    child: int
    kind: str
    confidence: float
    axis: str
    position: str
    rate: str
    range: str
    unit: str
    words: str


def joint_row(joint: Joint, names: Names | None = None) -> JointRow:
    """Format a joint."""
    return JointRow(
        parent=joint.parent,
        child=joint.child,
        kind=joint.kind,
        confidence=joint.confidence,
        axis="-" if joint.axis is None else " ".join(f"{x:.2f}" for x in joint.axis),
        position=_amount(joint, joint.position, joint.sigma_position),
        rate=_amount(joint, joint.rate),
        range="-"
        if joint.lower is None or joint.upper is None
        else f"{_amount(joint, joint.lower)} to {_amount(joint, joint.upper)}",
        unit="°" if joint.kind == "revolute" else " m",
        words=joint_words(joint, names),
    )


def _amount(joint: Joint, value: float | None, sigma: float | None = None) -> str:
    if value is None:
        return "-"
    hinge = joint.kind == "revolute"
    factor, digits = (float(np.degrees(1)), 1) if hinge else (1.0, 3)
    spread = "" if sigma is None else f" ± {factor * sigma:.{digits}f}"
    return f"{factor * value:.{digits}f}{spread}"


def as_json(update: HypothesisUpdate) -> dict[str, Any]:
    """Convert the joints of an update to plain values; what is unknown is left out."""
    return {"stamp_ns": update.stamp_ns, "joints": [known_values(joint) for joint in update.joints]}


def known_values(joint: Joint) -> dict[str, Any]:
    """Convert a joint to plain values; what is unknown is left out."""
    return {name: value for name, value in asdict(joint).items() if value is not None}


_PIECES = 16
# rad; a hinge that has hardly turned still has a visible arc.
_LEAST_ARC = 0.05

Lines = NDArray[np.float32]


def joint_lines(joint: Joint, child: Hypothesis, length: float) -> Lines:
    """Line segments of a joint, float32 [n, 2, dim]; none without an axis or a point.

    A hinge is its axis, and an arc around it from the lower to the upper position with a spoke to the
    child's place now. A slide is a rail from where the child was at the lower position to the upper one.

    Parameters
    ----------
    joint
        The joint.
    child
        Its child, as of the same update.
    length
        Of the axis to each side, in the unit of the space.
    """
    dim = len(child.centroid)
    if joint.point is None or joint.position is None or joint.lower is None or joint.upper is None:
        return np.zeros((0, 2, dim), np.float32)
    point, low, high = three(joint.point), joint.lower - joint.position, joint.upper - joint.position
    axis = np.array([0.0, 0.0, 1.0]) if joint.axis is None else three(joint.axis)
    if joint.kind == "prismatic":
        strips = [point + np.outer([low, high], axis), point + np.outer([-length, length], axis) / 4]
    else:
        strips = [*_arc(axis, point, three(child.centroid), low, high)]
        if dim == 3:
            strips.append(point + np.outer([-length, length], axis))
    pieces = [np.stack([strip[:-1], strip[1:]], axis=1) for strip in strips]
    return np.concatenate(pieces)[..., :dim].astype(np.float32)


def _arc(
    axis: NDArray[np.float64],
    point: NDArray[np.float64],
    centre: NDArray[np.float64],
    low: float,
    high: float,
) -> list[NDArray[np.float64]]:
    arm = centre - point
    arm = arm - axis * (axis @ arm)
    if not np.linalg.norm(arm) > 0:
        return []
    base = centre - arm
    angles = np.linspace(min(low, -_LEAST_ARC), max(high, _LEAST_ARC), _PIECES)
    arc = base + Rotation.from_rotvec(angles[:, None] * axis).apply(arm)
    return [arc, np.stack([base, centre])]
