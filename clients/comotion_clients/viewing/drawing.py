"""What is drawn, in 2-D and 3-D alike: Rerun's archetypes under paths, at one time. Needs the extra `view`.

Positions are float32 in the unit of their space, colours uint8 [N, 3], widths and radii points of the screen.
What comes later under a path replaces what was there; segments are drawn with those of the last
:data:`TRAIL_S` seconds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas import Box
from comotion_schemas.colours import RGB
from comotion_schemas.rigid import matrix

from .paths import clock, plain

TRAIL_S = 2.0
Axes = Literal["z-up", "optical", "y-up", "image"]
"""Orientation of a view: in 3-D z up or optical (z away from the camera), in 2-D y up or image (y down)."""
Positions: TypeAlias = NDArray[np.float32]
Colours: TypeAlias = NDArray[np.uint8]
_OPACITY = 0.4  # of regions over the image
_LINE = rr.Radius.ui_points(1.0)
_CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], np.float32)
_ALARM: RGB = (213, 94, 0)


@dataclass(frozen=True, eq=False)
class Shape:
    """What is logged under a path; its `style` only once."""

    path: str
    drawn: tuple[Any, ...]
    style: Any = None


@dataclass(frozen=True)
class Moment:
    """Shapes of one acquisition time, nanoseconds since the Unix epoch."""

    stamp_ns: int
    shapes: list[Shape]


def points(
    path: str, positions: Positions, colours: Colours, radius: float = 3.0, **values: NDArray[Any]
) -> Shape:
    """Points [N, dim]; the viewer shows `values` [N] on selection."""
    kind = rr.Points3D if positions.shape[1] == 3 else rr.Points2D
    drawn = kind(positions, colors=colours, radii=rr.Radius.ui_points(radius))
    return Shape(path, (drawn, rr.AnyValues(**values)) if values else (drawn,))


def labels(path: str, inks: Sequence[RGB], positions: Positions, words: Sequence[str]) -> Shape:
    """N texts in legible colours at positions [N, dim], without points."""
    kind = rr.Points3D if positions.shape[1] == 3 else rr.Points2D
    shades = np.array(inks, np.uint8).reshape(-1, 3)
    texts = {"labels": list(words), "show_labels": True} if words else {}
    return Shape(path, (kind(positions, colors=shades, radii=rr.Radius.ui_points(0.0), **texts),))


def segments(path: str, ends: Positions, colours: Colours) -> Shape:
    """Line segments: ends [N, 2, dim]."""
    strips = rr.LineStrips3D if ends.shape[2] == 3 else rr.LineStrips2D
    return Shape(path, (strips(ends, colors=colours, radii=_LINE),))


def arrows(path: str, origins: Positions, vectors: Positions, colours: Colours, radius: float) -> Shape:
    """Arrows [N, dim]."""
    kind = rr.Arrows3D if vectors.shape[1] == 3 else rr.Arrows2D
    radii = rr.Radius.ui_points(radius)
    return Shape(path, (kind(origins=origins, vectors=vectors, colors=colours, radii=radii),))


def boxes(path: str, around: Sequence[Box], colours: Colours, dim: int) -> Shape:
    """Wire frames of N boxes; Rerun's boxes do not turn in 2-D."""
    centers = np.array([box.center for box in around], np.float32).reshape(-1, dim)
    halves = np.array([box.half for box in around], np.float32).reshape(-1, dim)
    turns = np.array([matrix(box.rotation) for box in around], np.float32).reshape(-1, dim, dim)
    if dim == 2:
        corners = _CORNERS * halves[:, None] @ np.swapaxes(turns, 1, 2) + centers[:, None]
        return Shape(path, (rr.LineStrips2D(corners, colors=colours, radii=_LINE),))
    cubes = rr.Boxes3D(
        centers=centers,
        half_sizes=halves,
        quaternions=Rotation.from_matrix(turns).as_quat() if len(turns) else None,
        colors=colours,
        radii=_LINE,
        fill_mode="majorwireframe",
    )
    return Shape(path, (cubes,))


def image(path: str, jpeg: bytes) -> Shape:
    """A JPEG image; shapes in the same view have pixel coordinates."""
    return Shape(path, (rr.EncodedImage(contents=jpeg, media_type="image/jpeg", draw_order=-10.0),))


def regions(path: str, classes: NDArray[np.uint16], colours: Mapping[int, RGB]) -> Shape:
    """Classes [H, W] over the image of the same view, 0 for none, with the colour of each."""
    shades = [rr.AnnotationInfo(id=number, color=colour) for number, colour in colours.items()]
    overlay = rr.SegmentationImage(classes, opacity=_OPACITY, draw_order=-5.0)
    return Shape(path, (overlay, rr.AnnotationContext(shades)))


def value(path: str, number: float, name: str, colour: RGB) -> Shape:
    """A value of a curve, with its name and colour."""
    style = rr.SeriesLines(colors=[colour], names=[plain(name)], widths=[2.0])
    return Shape(path, (rr.Scalars(number),), style)


def entry(stamp_ns: int, text: str, colour: RGB = (140, 140, 140), level: str = "INFO") -> Shape:
    """A line of the log, with its time: the column of times is too narrow to read."""
    return Shape("log", (rr.TextLog(plain(f"{clock(stamp_ns)} {text}"), level=level, color=colour),))


def warning(stamp_ns: int, text: str) -> Shape:
    """A line of the log about what is wrong."""
    return entry(stamp_ns, text, _ALARM, "WARN")


def page(path: str, lines: Sequence[str]) -> Shape:
    """A page in Markdown."""
    text = "\n".join(map(plain, lines))
    return Shape(path, (rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN),))


def nothing(path: str) -> Shape:
    """Remove what is under a path."""
    return Shape(path, (rr.Clear(recursive=True),))


@dataclass(frozen=True)
class Eye:
    """Where a view in 3-D is looked at from, and at what, in the unit of the space."""

    position: tuple[float, ...]
    target: tuple[float, ...]


@dataclass(frozen=True)
class SpaceView:
    """View of a coordinate space or a camera: the shapes under `path`.

    Without an `eye` the viewer chooses one.
    """

    path: str
    name: str
    axes: Axes
    eye: Eye | None = None


@dataclass(frozen=True)
class Layout:
    """The views; `scored`: with curves of the scores."""

    spaces: tuple[SpaceView, ...] = ()
    cameras: tuple[SpaceView, ...] = ()
    scored: bool = False


Ids: TypeAlias = NDArray[np.uint64]
LONGEST_GAP_NS = 1_000_000_000
"""A feature that was missing for longer starts a new trail."""


class Trails:
    """The trails of one set of features, e.g. of one source in one space."""

    def __init__(self) -> None:
        self._last: tuple[object, int, Ids, Positions] | None = None

    def step(
        self, key: object, stamp_ns: int, ids: Ids, positions: Positions
    ) -> tuple[NDArray[np.intp], Positions]:
        """Add the positions of an instant.

        Parameters
        ----------
        key
            Identifies the set of ids; another key, such as a new session, starts new trails.
        stamp_ns
            Time of the positions; it must increase, else new trails start.
        ids
            uint64 [N], unique.
        positions
            float32 [N, dim].

        Returns
        -------
        Rows intp [M] with a segment, and segments float32 [M, 2, dim] from the last position.
        """
        old_ids, old_places = ids[:0], positions[:0]
        if self._last is not None and self._last[0] == key and 0 < stamp_ns - self._last[1] <= LONGEST_GAP_NS:
            _, _, old_ids, old_places = self._last
        self._last = key, stamp_ns, ids, positions
        _, rows, old = np.intersect1d(ids, old_ids, assume_unique=True, return_indices=True)
        return rows, np.stack([old_places[old], positions[rows]], axis=1)
