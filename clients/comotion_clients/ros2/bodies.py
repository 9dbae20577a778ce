"""Hypotheses -> frames in space: where a body is, how it is turned and how it moves in its own axes. Pure.

Plain numbers: for one vector at a time they are much faster than arrays.
"""

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from comotion_schemas import Hypothesis

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]
"""(x, y, z, w)."""


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

    one: Hypothesis
    origin: Vector
    quaternion: Quaternion
    linear: Vector = (0.0, 0.0, 0.0)
    angular: Vector = (0.0, 0.0, 0.0)


def bodies(hypotheses: Sequence[Hypothesis], spaces: Container[str]) -> list[Body]:
    """Frames of the hypotheses with current features in some spaces."""
    return [body(h) for h in hypotheses if h.space in spaces and not h.absent]


def body(one: Hypothesis) -> Body:
    """Frame of a hypothesis; in 2-D, in the plane z = 0."""
    centroid = spatial(one.centroid)
    origin = centroid if one.box is None else spatial(one.box.center)
    turn = quaternion(0.0 if one.pose is None else one.pose.rotation)
    if one.twist is None:
        return Body(one, origin, turn)
    spin = one.twist.angular
    about = spatial(spin) if isinstance(spin, list) else (0.0, 0.0, spin)
    arm = (origin[0] - centroid[0], origin[1] - centroid[1], origin[2] - centroid[2])
    turned, shift = cross(about, arm), spatial(one.twist.linear)
    moved = (shift[0] + turned[0], shift[1] + turned[1], shift[2] + turned[2])
    back = (-turn[0], -turn[1], -turn[2], turn[3])
    return Body(one, origin, turn, rotate(back, moved), rotate(back, about))


def quaternion(given: list[float] | float) -> Quaternion:
    """A quaternion (x, y, z, w) as it is, or that of an angle about z in rad."""
    if isinstance(given, list):
        x, y, z, w = given
        return x, y, z, w
    return 0.0, 0.0, math.sin(given / 2), math.cos(given / 2)


def spatial(values: list[float]) -> Vector:
    """Two or three coordinates as three."""
    x, y, z = (*values, 0.0)[:3]
    return x, y, z


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Turn a vector: v + 2 u x (u x v + w v), u the vector part."""
    u, w = q[:3], q[3]
    inner = cross(u, v)
    outer = cross(u, (inner[0] + w * v[0], inner[1] + w * v[1], inner[2] + w * v[2]))
    return v[0] + 2 * outer[0], v[1] + 2 * outer[1], v[2] + 2 * outer[2]
