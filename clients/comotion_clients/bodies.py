"""Hypotheses and joints for display: joints as text, values and lines; poses beside features; names. Pure.

Where the frame of a space moves, as that of a carried camera, everything is in the axes of the frame at the
stamp but `pose`, which is relative to the world. What is drawn beside the features needs it in their axes.
"""

from collections import ChainMap
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas import Hypothesis, HypothesisUpdate, Joint, Status
from comotion_schemas.naming import Names, joint_words
from comotion_schemas.rigid import pose_of, three, transform


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


_PIECES = 16
# rad; a hinge that has hardly turned still has a visible arc.
_LEAST_ARC = 0.05

Lines = NDArray[np.float32]


def joint_lines(joint: Joint, child: Hypothesis, length: float) -> Lines:
    """Line segments of a joint, float32 [n, 2, dim]; none without an axis or a point.

    A hinge is its axis, and an arc around it from the lower to the upper position with a spoke to the
    child's place now. A slide is a rail from where the child was at the lower position to the upper one.

    The `child` is of the same update; `length` is that of the axis to each side, in the unit of the space.
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


def poses_in_space(update: HypothesisUpdate) -> HypothesisUpdate:
    """The same update, with every pose in the axes of its space at the stamp.

    Where the frame of a space is known in the world, x(world) = F x(frame), the pose P of a hypothesis
    becomes F^-1 P: it takes the body from where it was born, in the axes of the world, to where it is in
    those of the frame.
    """
    if not update.frames:
        return update
    back = {space: transform(frame).inv() for space, frame in update.frames.items()}
    turned = [
        body
        if body.pose is None or body.space not in back
        else replace(body, pose=pose_of(back[body.space] * transform(body.pose), len(body.centroid)))
        for body in update.hypotheses
    ]
    return replace(update, hypotheses=turned)


_MOST_SOURCES = 256
# What does not move so soon after its birth is the background before that is known.
_YOUNG_NS = 2_000_000_000


class HypothesisNames(ChainMap[int, str]):
    """Name by id of a hypothesis: what a person gives, or else the name of a feature that it holds.

    A hypothesis keeps its name until another one holds that feature, and no two of a space have the same. Of
    several the last is taken: that of a robot's link which is farthest from its base. What rests from the
    start has none: a link that has not moved yet is there with all the background. A body in one space that
    is linked to a body with a name in another has that name. `given` are names that people give.
    """

    def __init__(self, given: Names | None = None) -> None:
        super().__init__(dict(given or {}), {}, {})
        self._of_features: dict[tuple[str, str], dict[int, str]] = {}

    def on_status(self, status: Status) -> None:
        """Add the Status of a component."""
        if not status.feature_names or len(self._of_features) >= _MOST_SOURCES:
            return
        names = {int(number): name for number, name in status.feature_names.items()}
        for key in [key for key in self._of_features if key[0] == status.component]:
            del self._of_features[key]
        self._of_features[status.component, status.session] = names

    def on_update(self, update: HypothesisUpdate) -> None:
        """Find the names of an update's hypotheses."""
        held: dict[int, list[str]] = {}
        for source in update.sources:
            if names := self._of_features.get((source.name, source.session)):
                for feature, hypothesis in update.hypotheses_of(source.name, source.session).items():
                    if feature in names:
                        held.setdefault(hypothesis, []).append(names[feature])
        grown_ns = update.stamp_ns - _YOUNG_NS
        moved = (h for h in update.hypotheses if h.state != "static")
        living = {h.id: held.get(h.id, []) for h in moved if h.state == "moving" or h.born_ns <= grown_ns}
        holders = {name: hypothesis for hypothesis, names_held in held.items() for name in names_held}
        kept = {
            hypothesis: name
            for hypothesis, name in self.maps[1].items()
            if hypothesis in living and holders.get(name, hypothesis) == hypothesis
        }
        for hypothesis, names_held in living.items():
            taken = set(kept.values())
            free = [name for name in names_held if name not in taken]
            if hypothesis not in kept and free:
                kept[hypothesis] = free[-1]
        self.maps[1:] = [kept, {}]
        links = [(h.id, link) for h in update.hypotheses for link in h.linked or () if link in self]
        self.maps[2] = {hypothesis: self[link] for hypothesis, link in links}
