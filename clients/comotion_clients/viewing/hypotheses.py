"""Draws hypotheses: label, body frame, box, arrows of the twist, and joints. Pure."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Hypothesis, Joint
from comotion_schemas.colours import Palette
from comotion_schemas.naming import Names, joint_words, named
from comotion_schemas.rigid import matrix

from ..bodies import joint_lines
from .drawing import Colours, Eye, Positions, Shape, arrows, boxes, labels, segments

# Red, green and blue for x, y and z, as in other viewers; they differ in lightness as well.
AXES = np.array([(222, 60, 50), (90, 190, 80), (70, 110, 250)], np.uint8)
SHOWN = 0.1
"""Arrows shorter than this share of an axis are left out."""
LONGEST = 4.0
"""Arrows are cut at this multiple of an axis: the velocity of few features may be far too large."""
# Height of a label as a share of an axis, and where there is an eye, of its distance.
_ROW_SHARE, _ROW_SEEN = 0.8, 0.055
_AXIS_SHARE = 0.07  # length of an axis as a share of the extent of the features


def axis_length(positions: Positions, current: float) -> float:
    """Choose the length of the axes: a share of the extent of the features.

    `positions` are float32 [N, dim]; the `current` length is kept unless it is wrong by a factor of 2.
    """
    if len(positions) < 2:
        return current
    low, high = np.percentile(positions, (5, 95), axis=0)
    length = float(_AXIS_SHARE * np.linalg.norm(high - low))
    if length <= 0 or (current > 0 and 0.5 < length / current < 2):
        return current
    return length


@dataclass(frozen=True, eq=False)
class BodyDrawing:
    """Draws the hypotheses of one space, and their joints."""

    path: str  # what is drawn is under it
    up: Sequence[float]  # unit vector [dim]; labels are lifted along it
    axis: float  # length of an axis, in the unit of the space
    # Colours and names of hypotheses.
    palette: Palette
    names: Names = field(default_factory=dict)
    eye: Eye | None = None  # where the space is seen from, in 3-D

    def bodies(self, hypotheses: Sequence[Hypothesis]) -> list[Shape]:
        """Draw labels, axes, velocities and boxes.

        The arrow of the linear velocity ends where the centroid will be in 1 s. The arrow of the angular
        velocity points along the axis of rotation and is one axis long at 1 rad/s. In 2-D it shows the
        distance that the tip of the x axis moves in 1 s. Of absent hypotheses only the label is drawn. Boxes
        are those of bodies: the box of what is at rest would surround the scene.
        """
        eye, dim = self.eye, len(self.up)
        lifts = np.outer([_height(h, self.up) for h in hypotheses], self.up).astype(np.float32)
        away = float(np.linalg.norm(np.subtract(eye.position, eye.target))) if eye else 0.0
        row = _ROW_SEEN * away or _ROW_SHARE * self.axis
        places = apart(_centroids(hypotheses, dim) + lifts, self.up, row, eye)
        inks = [self.palette.legible(h.id) for h in hypotheses]
        shown = [h for h in hypotheses if not h.absent]
        boxed = [(h.id, h.box) for h in shown if h.box is not None and h.state != "static"]
        shades = self._shades([number for number, _ in boxed])
        return [
            labels(f"{self.path}/hypotheses", inks, places, [label(h, self.names) for h in hypotheses]),
            self._frames(shown),
            *self._twists(shown),
            boxes(f"{self.path}/boxes", [box for _, box in boxed], shades, dim),
        ]

    def joints(self, hypotheses: Sequence[Hypothesis], joints: Sequence[Joint]) -> list[Shape]:
        """Draw the joints in the colours of their children: axis, arc or rail, and words.

        No shape where there is none.
        """
        by_id = {h.id: h for h in hypotheses}
        drawn = [joint for joint in joints if joint.child in by_id and joint.point is not None]
        if not drawn:
            return []
        lines = [joint_lines(joint, by_id[joint.child], 2 * self.axis) for joint in drawn]
        children = self._shades([joint.child for joint in drawn])
        shades = np.repeat(children, [len(line) for line in lines], axis=0)
        inks = [self.palette.legible(joint.child) for joint in drawn]
        places = np.array([joint.point for joint in drawn], np.float32)
        words = [joint_words(joint, self.names) for joint in drawn]
        return [
            segments(f"{self.path}/joints", np.concatenate(lines), shades),
            labels(f"{self.path}/joint-words", inks, places, words),
        ]

    def _shades(self, ids: Sequence[int]) -> Colours:
        return self.palette.colours(np.array(ids, np.uint32))

    def _frames(self, hypotheses: Sequence[Hypothesis]) -> Shape:
        """The axes of the space, rotated by the rotation since birth."""
        dim, posed = len(self.up), [h for h in hypotheses if h.pose is not None]
        turns = np.array([_matrix(h) for h in posed], np.float32).reshape(-1, dim, dim)
        # Column k of a rotation matrix is where it takes axis k.
        vectors = self.axis * np.swapaxes(turns, 1, 2).reshape(-1, dim)
        origins = np.repeat(_centroids(posed, dim), dim, axis=0)
        colours = np.tile(AXES[:dim], (len(posed), 1))
        return arrows(f"{self.path}/frames", origins, vectors.astype(np.float32), colours, 1.2)

    def _twists(self, hypotheses: Sequence[Hypothesis]) -> Iterator[Shape]:
        """Linear and angular velocities that are long enough to be visible, of limited length."""
        axis, centroids = self.axis, _centroids(hypotheses, len(self.up))
        linear, angular, tips = np.zeros_like(centroids), np.zeros_like(centroids), centroids.copy()
        for k, h in enumerate(hypotheses):
            if h.twist is None:
                continue
            linear[k] = h.twist.linear
            if isinstance(h.twist.angular, list):
                angular[k] = h.twist.angular
            else:
                turn = _matrix(h)
                tips[k] += axis * turn[:, 0]
                angular[k] = h.twist.angular * turn[:, 1]
        shades = self._shades([h.id for h in hypotheses])
        for name, origins, vectors, radius in (
            ("linear", centroids, linear, 2.5),
            ("angular", tips, axis * angular, 1.2),
        ):
            lengths = np.linalg.norm(vectors, axis=1)
            rows = np.flatnonzero(lengths > SHOWN * axis)
            shares = np.minimum(1.0, LONGEST * axis / lengths[rows])
            cut = (vectors[rows] * shares[:, None]).astype(np.float32)
            yield arrows(f"{self.path}/twist/{name}", origins[rows], cut, shades[rows], radius)


def apart(places: Positions, up: Sequence[float], row: float, eye: Eye | None = None) -> Positions:
    """Lift labels that would cover one another.

    `places` are float32 [N, dim], `up` is a unit vector [dim], `row` the height of a label; most are not
    wider than four times that. In 3-D they are seen from an `eye`; otherwise they are as far apart as their
    places.
    """
    upward, lifted = np.array(up, np.float64), places.astype(np.float64)
    for k in range(1, len(lifted)):
        # Each lift clears at least one of the labels before it.
        for _ in range(k):
            *others, place, raised = _seen(np.vstack([lifted[: k + 1], lifted[k] + upward]), eye)
            away, rise = np.array(others) - place, float(np.linalg.norm(raised - place))
            above = away @ (raised - place) / rise
            across = np.linalg.norm(away - np.outer(above, (raised - place) / rise), axis=1)
            covered = (np.abs(above) < 0.99 * row) & (across < 4 * row)
            if not covered.any():
                break
            lifted[k] += (above[covered].max() + row) / rise * upward
    return lifted.astype(np.float32)


def _seen(places: NDArray[np.float64], eye: Eye | None) -> NDArray[np.float64]:
    """Places [N, dim] as they cover each other: for an eye, in the plane of its target."""
    if eye is None:
        return places
    position = np.array(eye.position)
    ahead = np.array(eye.target) - position
    depth = (places - position) @ ahead / (ahead @ ahead)
    return np.asarray((places - position) / np.maximum(depth, 1e-3)[:, None], np.float64)


def _height(hypothesis: Hypothesis, up: Sequence[float]) -> float:
    """How far the box of a body reaches above its centroid."""
    box = hypothesis.box
    if box is None or hypothesis.absent or hypothesis.state == "static":
        return 0.0
    reach = np.abs(np.array(up) @ matrix(box.rotation)) @ np.array(box.half)
    return max(0.0, float(np.dot(np.array(box.center) - hypothesis.centroid, up) + reach))


def label(hypothesis: Hypothesis, names: Names) -> str:
    """Text of a hypothesis: its name or id, and its state if known."""
    name = named(hypothesis.id, names)
    if hypothesis.absent:
        return f"{name} absent"
    state = "" if hypothesis.state == "undetermined" else f" {hypothesis.state}"
    return f"{name}{state}" if hypothesis.confirmed else f"{name}{state}?"


def _centroids(hypotheses: Sequence[Hypothesis], dim: int) -> Positions:
    return np.array([h.centroid for h in hypotheses], np.float32).reshape(-1, dim)


def _matrix(hypothesis: Hypothesis) -> NDArray[np.float64]:
    return np.eye(len(hypothesis.centroid)) if hypothesis.pose is None else matrix(hypothesis.pose.rotation)
