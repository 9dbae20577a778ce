"""Shapes: what a viewer draws, independent of the viewer.

Every shape has a path. Positions are float32 in the unit of their space, 2-D or 3-D; colours uint8
[N, 3]. A later shape of the same path and kind replaces the earlier one; segments are drawn with those
of the last :data:`TRAIL_S` seconds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.colours import RGB

TRAIL_S = 2.0
Axes = Literal["z-up", "optical", "y-up", "image"]
"""Orientation of a view: in 3-D z up or optical (z away from the camera), in 2-D y up or image (y down)."""
Positions: TypeAlias = NDArray[np.float32]
Colours: TypeAlias = NDArray[np.uint8]
Level = Literal["INFO", "WARN"]


@dataclass(frozen=True, eq=False)
class Points:
    """Points [N, dim]; `radius` in points of the screen, `values` [N] that a viewer shows on selection."""

    path: str
    positions: Positions
    colours: Colours
    radius: float = 3.0
    labels: tuple[str, ...] = ()
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Segments:
    """Line segments: ends [N, 2, dim]."""

    path: str
    ends: Positions
    colours: Colours


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows [N, dim] from `origins`; `radius` in points of the screen."""

    path: str
    origins: Positions
    vectors: Positions
    colours: Colours
    radius: float = 1.5


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes [N, dim]: centres, half lengths, and `turns` [N, dim, dim] of their axes."""

    path: str
    centers: Positions
    halves: Positions
    turns: Positions
    colours: Colours


@dataclass(frozen=True)
class Image:
    """A JPEG image; shapes in the same view have pixel coordinates."""

    path: str
    jpeg: bytes


@dataclass(frozen=True, eq=False)
class Regions:
    """Classes uint16 [H, W] over the image of the same view, 0 for none, with the colour of each."""

    path: str
    classes: NDArray[np.uint16]
    colours: Mapping[int, RGB]


@dataclass(frozen=True)
class Number:
    """A value of a time series, with the name and colour of its curve."""

    path: str
    value: float
    name: str
    colour: RGB


@dataclass(frozen=True)
class Entry:
    """A line of the log."""

    path: str
    text: str
    level: Level = "INFO"
    colour: RGB = (140, 140, 140)


@dataclass(frozen=True)
class Document:
    """A page in Markdown."""

    path: str
    text: str


@dataclass(frozen=True)
class Cleared:
    """Removes the shapes under a path."""

    path: str


Shape: TypeAlias = Points | Segments | Arrows | Boxes | Image | Regions | Number | Entry | Document | Cleared


@dataclass(frozen=True)
class Moment:
    """Shapes of one acquisition time, nanoseconds since the Unix epoch."""

    stamp_ns: int
    shapes: list[Shape]


@dataclass(frozen=True)
class Eye:
    """Where a view in 3-D is looked at from, and at what, in the unit of the space."""

    position: tuple[float, ...]
    target: tuple[float, ...]


@dataclass(frozen=True)
class SpaceView:
    """View of a coordinate space: the shapes under `path`; without an `eye` the viewer chooses one."""

    path: str
    name: str
    axes: Axes
    eye: Eye | None = None


@dataclass(frozen=True)
class CameraView:
    """View of a camera: the shapes under `path`."""

    path: str
    name: str


@dataclass(frozen=True)
class Grid:
    """A grid for labels from (0, 0) on: columns are `width` apart, rows `height`; dots are `lift` higher."""

    columns: int
    rows: int
    width: float
    height: float
    lift: float


LEGEND = Grid(columns=4, rows=2, width=4.8, height=1.8, lift=0.35)


@dataclass(frozen=True)
class Layout:
    """The views; `scored`: with curves of the scores."""

    spaces: tuple[SpaceView, ...] = ()
    cameras: tuple[CameraView, ...] = ()
    scored: bool = False
