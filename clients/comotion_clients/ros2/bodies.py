"""Hypotheses -> frames in space: where a body is, how it is turned and how it moves in its own axes. Pure."""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from comotion_schemas import Hypothesis
from comotion_schemas.rigid import rotation, spin, three


@dataclass(frozen=True)
class Body:
    """The frame of one hypothesis in its space.

    The origin is the middle of its box, or its centroid without one; the axes are those of the space at its
    birth, turned with the body.

    Attributes
    ----------
    origin, quaternion
        In m, and (x, y, z, w).
    linear, angular
        m/s of the origin and rad/s, in the axes of the frame; zero where unknown.
    """

    hypothesis: Hypothesis
    origin: Sequence[float]
    quaternion: Sequence[float]
    linear: Sequence[float] = (0.0, 0.0, 0.0)
    angular: Sequence[float] = (0.0, 0.0, 0.0)


def bodies(hypotheses: Sequence[Hypothesis], spaces: Container[str]) -> list[Body]:
    """Frames of the hypotheses with current features in some spaces."""
    return [body(h) for h in hypotheses if h.space in spaces and not h.absent]


def body(hypothesis: Hypothesis) -> Body:
    """Frame of a hypothesis; in 2-D, in the plane z = 0."""
    centroid, box, twist = three(hypothesis.centroid), hypothesis.box, hypothesis.twist
    origin = centroid if box is None else three(box.center)
    turn = rotation(0.0 if hypothesis.pose is None else hypothesis.pose.rotation)
    placed = Body(hypothesis, origin.tolist(), turn.as_quat().tolist())
    if twist is None:
        return placed
    back, about = turn.inv(), spin(twist)
    moved = three(twist.linear) + np.cross(about, origin - centroid)
    return replace(placed, linear=back.apply(moved).tolist(), angular=back.apply(about).tolist())
