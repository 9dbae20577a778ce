"""Draws an update: features by space and source, their trails, and hypotheses. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import HypothesisUpdate
from comotion_schemas.colours import Palette
from comotion_schemas.naming import Names

from ..bodies import poses_in_space
from ..scoring import SpaceRef, spaces_of
from .drawing import Axes, Eye, Positions, Shape, SpaceView, Trails, nothing, points, segments
from .hypotheses import axis_length, draw_hypotheses, draw_joints
from .paths import Paths

_UP: Mapping[Axes, tuple[float, ...]] = {
    "z-up": (0, 0, 1),
    "optical": (0, -1, 0),
    "y-up": (0, 1),
    "image": (0, -1),
}
_SEEN_FROM: Mapping[Axes, tuple[float, ...]] = {"z-up": (-0.3, -0.85, 0.45), "optical": (0.2, -0.3, -0.95)}
"""Direction of the eye from what it looks at."""
_DISTANCE = 0.9
"""Of the eye, as a multiple of the diagonal of the features."""
_CONTEXT, _SURROUNDED = 0.45, 1.6
"""Least diagonal in view, as a share of that of all features and a multiple of that of those that move."""


@dataclass
class _Space:
    ref: SpaceRef
    view: SpaceView
    sources: Paths
    axis: float = 0.0
    aimed: int = 0  # number of sources that the eye was chosen for
    followed: bool = False  # whether it looks at what moves


class Features:
    """Draws updates in order; stores the last position of each feature for the trails.

    `palette` has seen the updates.
    """

    def __init__(self, palette: Palette | None = None, names: Names | None = None) -> None:
        self._palette = palette or Palette()
        self._names = {} if names is None else names  # they may still come
        self._spaces: dict[str, _Space] = {}
        self._paths = Paths("spaces")
        self._trails: dict[str, Trails] = {}
        self._drawn: set[str] = set()

    @property
    def views(self) -> dict[str, SpaceView]:
        """Space name -> view of every space with features so far."""
        return {name: space.view for name, space in self._spaces.items()}

    def draw(self, update: HypothesisUpdate, published: Mapping[str, SpaceRef]) -> list[Shape]:
        """Draw an update, and clear shapes of the update before that it does not replace.

        `published`: space of each source, from its batches.
        """
        update, refs = poses_in_space(update), spaces_of(update, published)
        shapes: list[Shape] = []
        for ref in dict.fromkeys(refs):
            space = self._space(ref)
            sources = [number for number, other in enumerate(refs) if other == ref]
            shapes += self._draw_space(update, space, sources)
        paths = {shape.path for shape in shapes}
        gone = self._drawn - paths
        self._trails = {path: trails for path, trails in self._trails.items() if path in paths}
        self._drawn = paths
        return [*map(nothing, sorted(gone)), *shapes]

    def _space(self, ref: SpaceRef) -> _Space:
        space = self._spaces.get(ref.name)
        if space is None or space.ref != ref:
            axes: Axes = "optical" if ref.name.endswith("optical") else "z-up"
            if ref.dim == 2:
                axes = "y-up" if ref.unit == "m" else "image"
            view = SpaceView(self._paths(ref.name), ref.name, axes)
            space = self._spaces[ref.name] = _Space(ref, view, Paths(f"{view.path}/features"))
        return space

    def _draw_space(self, update: HypothesisUpdate, space: _Space, sources: list[int]) -> list[Shape]:
        dim = space.ref.dim
        rows_of_space = np.isin(update.track_source, sources)
        everything = update.track_position[rows_of_space, :dim]
        moving = [h.id for h in update.hypotheses if h.state == "moving" and h.space == space.ref.name]
        _aim(space, everything, len(sources), np.isin(update.track_hypothesis[rows_of_space], moving))
        shapes: list[Shape] = []
        trailing = []
        for number in sources:
            rows = update.track_source == number
            path, ids = space.sources(update.sources[number].name), update.track_id[rows]
            places = np.nan_to_num(update.track_position[rows, :dim])
            colours = self._palette.colours(update.track_hypothesis[rows])
            confidence = update.track_confidence[rows]
            shapes.append(points(path, places, colours, feature=ids, confidence=confidence))
            trails = self._trails.setdefault(path, Trails())
            moved, ends = trails.step(update.sources[number].session, update.stamp_ns, ids, places)
            trailing.append((ends, colours[moved]))
        ends, colours = (np.concatenate(parts) for parts in zip(*trailing, strict=True))
        shapes.append(segments(f"{space.view.path}/trails", ends, colours))
        bodies = [h for h in update.hypotheses if h.space == space.ref.name and len(h.centroid) == dim]
        shapes += draw_joints(space.view.path, bodies, update.joints, space.axis, self._palette, self._names)
        seen = space.axis, _UP[space.view.axes], self._palette, self._names, space.view.eye
        return shapes + draw_hypotheses(space.view.path, bodies, *seen)


def _aim(space: _Space, positions: Positions, sources: int, moving: NDArray[np.bool_]) -> None:
    """Choose the length of the axes, and where the eye is.

    It is placed again if the length changes, a source has come, or something moves for the first time.
    """
    previous, space.axis = space.axis, axis_length(positions, space.axis)
    if space.view.axes not in _SEEN_FROM or not space.axis:
        return
    begins = not space.followed and bool(moving.any())
    if sources > space.aimed or space.axis != previous or begins:
        space.aimed, space.followed = sources, space.followed or begins
        direction = np.array(_SEEN_FROM[space.view.axes])
        space.view = replace(space.view, eye=look_at(positions, direction, moving))


def look_at(positions: Positions, direction: NDArray[np.float64], moving: NDArray[np.bool_]) -> Eye:
    """Place an eye so that what moves, with its surroundings, fills the view of features [N, 3].

    `direction` points from them to it; `moving` [N] names those that move. Without any all features do.
    """
    low, high = np.percentile(positions, (5, 95), axis=0)
    diagonal = float(np.linalg.norm(high - low))
    if moving.any():
        low, high = np.percentile(positions[moving], (5, 95), axis=0)
        near = _SURROUNDED * float(np.linalg.norm(high - low))
        diagonal = min(max(_CONTEXT * diagonal, near), diagonal)
    away = _DISTANCE * diagonal / np.linalg.norm(direction)
    target = (low + high) / 2
    return Eye(tuple((target + away * direction).tolist()), tuple(target.tolist()))
