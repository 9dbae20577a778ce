"""Joints of an update -> rows of text, or plain values."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from comotion_schemas import HypothesisUpdate, Joint
from comotion_schemas.naming import Names, joint_words


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
