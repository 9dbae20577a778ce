"""What there is to see, without regard to who shows it: arrays, colours and words under a path.

Positions are float32 in the unit of their space, 2-D or 3-D; colours uint8 [N, 3]. A later shape of
the same path and kind replaces the earlier one; segments are drawn together with those of the last
:data:`TRAIL_S` seconds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..colours import RGB

TRAIL_S = 2.0
Axes = Literal["z-up", "optical", "y-up", "image"]
"""How a space is looked at: two ways in 3-D (optical: z away from the camera), two in 2-D (image: y down)."""
Places: TypeAlias = NDArray[np.float32]
Colours: TypeAlias = NDArray[np.uint8]
Level = Literal["INFO", "WARN"]


@dataclass(frozen=True, eq=False)
class Points:
    """Points [N, dim]; `radius` in points of the screen, `values` [N] to be read on demand."""

    path: str
    positions: Places
    colours: Colours
    radius: float = 3.0
    labels: tuple[str, ...] = ()
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Segments:
    """Lines from one place to another: ends [N, 2, dim]."""

    path: str
    ends: Places
    colours: Colours


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows [N, dim] from `origins`; `radius` in points of the screen."""

    path: str
    origins: Places
    vectors: Places
    colours: Colours
    radius: float = 1.5


@dataclass(frozen=True)
class Image:
    """A JPEG image; its pixels are the coordinates of what is drawn beside it."""

    path: str
    jpeg: bytes


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
class Nothing:
    """What was under this path is no more."""

    path: str


Shape: TypeAlias = Points | Segments | Arrows | Image | Number | Entry | Document | Nothing


@dataclass(frozen=True)
class Moment:
    """Shapes of one time: nanoseconds since the Unix epoch, of acquisition."""

    stamp_ns: int
    shapes: list[Shape]


@dataclass(frozen=True)
class SpaceView:
    """A coordinate space to be shown: what is under `path`."""

    path: str
    name: str
    axes: Axes


@dataclass(frozen=True)
class CameraView:
    """A camera whose images are shown: what is under `path`."""

    path: str
    name: str


@dataclass(frozen=True)
class Grid:
    """Places for words, from (0, 0) on, a row at a distance of 1."""

    columns: int
    rows: int
    width: float


LEGEND = Grid(columns=4, rows=3, width=3.3)


@dataclass(frozen=True)
class Layout:
    """What needs a view of its own; `scored`: there is a truth to compare with."""

    spaces: tuple[SpaceView, ...] = ()
    cameras: tuple[CameraView, ...] = ()
    scored: bool = False
