"""Hypotheses -> shapes: label, body frame, and arrows of the twist. Pure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Hypothesis, Joint
from comotion_schemas.colours import RGB, Palette
from comotion_schemas.naming import Names, joint_words, named
from comotion_schemas.rigid import matrix

from ..joint_lines import joint_lines
from .shapes import Arrows, Boxes, Eye, Points, Positions, Segments, Shape

# Red, green and blue for x, y and z, as in other viewers; they differ in lightness as well.
AXES = np.array([(222, 60, 50), (90, 190, 80), (70, 110, 250)], np.uint8)
SHOWN = 0.1
"""Arrows shorter than this share of an axis are left out."""
LONGEST = 4.0
"""Arrows are cut at this multiple of an axis: the velocity of few features may be far too large."""
# Height of a label as a share of an axis, and where there is an eye, of its distance.
_ROW_SHARE, _ROW_SEEN = 0.8, 0.055
_AXIS_SHARE = 0.07  # length of an axis as a share of the extent of the features


def axis_length(positions: Positions, before: float) -> float:
    """Choose the length of the axes: a share of the extent of the features.

    Parameters
    ----------
    positions
        float32 [N, dim].
    before
        Length of the update before; it is kept unless it is wrong by a factor of 2.
    """
    if len(positions) < 2:
        return before
    low, high = np.percentile(positions, (5, 95), axis=0)
    length = float(_AXIS_SHARE * np.linalg.norm(high - low))
    if length <= 0 or (before > 0 and 0.5 < length / before < 2):
        return before
    return length


def draw_hypotheses(
    path: str,
    hypotheses: Sequence[Hypothesis],
    axis: float,
    up: Sequence[float],
    palette: Palette,
    names: Names | None = None,
    eye: Eye | None = None,
) -> list[Shape]:
    """Draw the hypotheses of one space, with axes of length `axis`, their labels above them where `up` is.

    The arrow of the linear velocity ends where the centroid will be in 1 s. The arrow of the angular
    velocity points along the axis of rotation and is one axis long at 1 rad/s. In 2-D it shows the
    distance that the tip of the x axis moves in 1 s. Of absent hypotheses only the label is drawn. Boxes are
    those of bodies: the box of what is at rest would surround the scene.
    """
    ids = np.array([h.id for h in hypotheses], np.uint32)
    dim = len(up)
    centroids = np.array([h.centroid for h in hypotheses], np.float32).reshape(-1, dim)
    shades = palette.colours(ids)
    inks = [palette.legible(h.id) for h in hypotheses]
    tops = centroids + np.outer([_height(h, up) for h in hypotheses], up).astype(np.float32)
    away = np.linalg.norm(np.subtract(eye.position, eye.target)) if eye else 0.0
    places = apart(tops, up, _ROW_SEEN * float(away) or _ROW_SHARE * axis, eye)
    words = labels(f"{path}/hypotheses", inks, places, tuple(label(h, names) for h in hypotheses))
    rows = [k for k, h in enumerate(hypotheses) if not h.absent]
    hypotheses, centroids, shades = [hypotheses[k] for k in rows], centroids[rows], shades[rows]
    return [
        words,
        _frames(path, hypotheses, centroids, axis),
        _velocities(path, hypotheses, centroids, shades, axis),
        _angular_velocities(path, hypotheses, centroids, shades, axis),
        _boxes(path, hypotheses, shades, dim),
    ]


def draw_joints(
    path: str,
    hypotheses: Sequence[Hypothesis],
    joints: Sequence[Joint],
    axis: float,
    palette: Palette,
    names: Names | None = None,
) -> list[Shape]:
    """Draw the joints of one space in the colours of their children: axis, arc or rail, and words.

    No shape where there is none.
    """
    by_id = {h.id: h for h in hypotheses}
    drawn = [joint for joint in joints if joint.child in by_id and joint.point is not None]
    if not drawn:
        return []
    lines = [joint_lines(joint, by_id[joint.child], 2 * axis) for joint in drawn]
    children = palette.colours(np.array([joint.child for joint in drawn], np.uint32))
    shades = np.repeat(children, [len(line) for line in lines], axis=0)
    inks = [palette.legible(joint.child) for joint in drawn]
    points = np.array([joint.point for joint in drawn], np.float32)
    words = tuple(joint_words(joint, names) for joint in drawn)
    return [
        Segments(f"{path}/joints", np.concatenate(lines), shades),
        labels(f"{path}/joint-words", inks, points, words),
    ]


def labels(path: str, inks: Sequence[RGB], positions: Positions, words: tuple[str, ...]) -> Points:
    """Build labels without points.

    Parameters
    ----------
    path
        Path of the shape.
    inks
        N legible colours.
    positions
        float32 [N, dim].
    words
        N texts.
    """
    shades = np.array(inks, np.uint8).reshape(-1, 3)
    return Points(path, positions, shades, radius=0.0, labels=words)


def apart(places: Positions, up: Sequence[float], row: float, eye: Eye | None = None) -> Positions:
    """Lift labels that would cover one another.

    Parameters
    ----------
    places
        float32 [N, dim].
    up
        Unit vector [dim].
    row
        Height of a label; most are not wider than four times that.
    eye
        Where it is seen from, in 3-D; otherwise labels are as far apart as their places.
    """
    upward, lifted = np.array(up, np.float64), places.astype(np.float64)
    for k in range(1, len(lifted)):
        # Each lift clears at least one of the labels before it.
        for _ in range(k):
            *others, here, raised = _seen(np.vstack([lifted[: k + 1], lifted[k] + upward]), eye)
            away, rise = np.array(others) - here, float(np.linalg.norm(raised - here))
            above = away @ (raised - here) / rise
            across = np.linalg.norm(away - np.outer(above, (raised - here) / rise), axis=1)
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


def label(hypothesis: Hypothesis, names: Names | None = None) -> str:
    """Text of a hypothesis: its name or id, and its state if known."""
    name = named(hypothesis.id, names or {})
    if hypothesis.absent:
        return f"{name} absent"
    state = "" if hypothesis.state == "undetermined" else f" {hypothesis.state}"
    return f"{name}{state}" if hypothesis.confirmed else f"{name}{state}?"


def _frames(path: str, hypotheses: Sequence[Hypothesis], centroids: Positions, axis: float) -> Arrows:
    """The axes of the space, rotated by the rotation since birth."""
    rows = [k for k, h in enumerate(hypotheses) if h.pose is not None]
    dim = centroids.shape[1]
    turns = np.array([_matrix(hypotheses[k]) for k in rows], np.float32).reshape(-1, dim, dim)
    # Column k of a rotation matrix is where it takes axis k.
    vectors = axis * np.swapaxes(turns, 1, 2).reshape(-1, dim)
    origins = np.repeat(centroids[rows], dim, axis=0)
    return Arrows(
        f"{path}/frames", origins, vectors.astype(np.float32), np.tile(AXES[:dim], (len(rows), 1)), 1.2
    )


def _velocities(
    path: str, hypotheses: Sequence[Hypothesis], centroids: Positions, shades: NDArray[np.uint8], axis: float
) -> Arrows:
    linear = np.array(
        [h.twist.linear if h.twist else [0.0] * centroids.shape[1] for h in hypotheses], np.float32
    ).reshape(centroids.shape)
    rows, vectors = _in_sight(linear, axis)
    return Arrows(f"{path}/twist/linear", centroids[rows], vectors, shades[rows], 2.5)


def _angular_velocities(
    path: str, hypotheses: Sequence[Hypothesis], centroids: Positions, shades: NDArray[np.uint8], axis: float
) -> Arrows:
    origins, vectors = centroids.copy(), np.zeros_like(centroids)
    for k, h in enumerate(hypotheses):
        if h.twist is None:
            continue
        if isinstance(h.twist.angular, list):
            vectors[k] = h.twist.angular
        else:
            turn = _matrix(h)
            origins[k] += axis * turn[:, 0]
            vectors[k] = h.twist.angular * turn[:, 1]
    rows, arrows = _in_sight(axis * vectors, axis)
    return Arrows(f"{path}/twist/angular", origins[rows], arrows, shades[rows], 1.2)


def _boxes(path: str, hypotheses: Sequence[Hypothesis], shades: NDArray[np.uint8], dim: int) -> Boxes:
    rows = [k for k, h in enumerate(hypotheses) if h.box is not None and h.state != "static"]
    boxes = [box for k in rows if (box := hypotheses[k].box) is not None]
    return Boxes(
        f"{path}/boxes",
        np.array([box.center for box in boxes], np.float32).reshape(-1, dim),
        np.array([box.half for box in boxes], np.float32).reshape(-1, dim),
        np.array([matrix(box.rotation) for box in boxes], np.float32).reshape(-1, dim, dim),
        shades[rows],
    )


def _in_sight(vectors: Positions, axis: float) -> tuple[NDArray[np.intp], Positions]:
    """Select the vectors that are long enough to be visible, and limit their length."""
    lengths = np.linalg.norm(vectors, axis=1)
    rows = np.flatnonzero(lengths > SHOWN * axis)
    shares = np.minimum(1.0, LONGEST * axis / lengths[rows])
    return rows, (vectors[rows] * shares[:, None]).astype(np.float32)


def _matrix(hypothesis: Hypothesis) -> NDArray[np.float64]:
    return np.eye(len(hypothesis.centroid)) if hypothesis.pose is None else matrix(hypothesis.pose.rotation)
