"""Update -> shapes: features by space and source, trails, and hypotheses. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from comotion_schemas import HypothesisUpdate
from comotion_schemas.colours import Palette
from comotion_schemas.naming import Names

from ..carried import poses_in_space
from ..scoring import SpaceRef, spaces_of
from .hypotheses import axis_length, draw_hypotheses, draw_joints
from .paths import Paths
from .shapes import Axes, Cleared, Colours, Points, Positions, Segments, Shape, SpaceView
from .trails import Trails


@dataclass
class _Space:
    ref: SpaceRef
    view: SpaceView
    axis: float = 0.0
    sources: Paths = field(init=False)

    def __post_init__(self) -> None:
        self.sources = Paths(f"{self.view.path}/features")


class Features:
    """Draws updates in order; stores the last position of each feature for the trails.

    `palette` has seen the updates.
    """

    def __init__(self, palette: Palette | None = None, names: Names | None = None) -> None:
        self._palette = palette or Palette()
        self._names = names or {}
        self._spaces: dict[str, _Space] = {}
        self._paths = Paths("spaces")
        self._trails: dict[str, Trails] = {}
        self._drawn: set[str] = set()

    @property
    def views(self) -> dict[str, SpaceView]:
        """Space name -> view of every space with features so far."""
        return {name: space.view for name, space in self._spaces.items()}

    def draw(self, update: HypothesisUpdate, known: Mapping[str, SpaceRef]) -> list[Shape]:
        """Draw an update, and clear shapes of the update before that it does not replace.

        Parameters
        ----------
        update
            The update.
        known
            Source -> space, from its batches.
        """
        update, refs = poses_in_space(update), spaces_of(update, known)
        shapes: list[Shape] = []
        for ref in dict.fromkeys(refs):
            space = self._space(ref)
            sources = [number for number, other in enumerate(refs) if other == ref]
            shapes += self._draw_space(update, space, sources)
        paths = {shape.path for shape in shapes}
        gone = self._drawn - paths
        self._trails = {path: trails for path, trails in self._trails.items() if path in paths}
        self._drawn = paths
        return [*(Cleared(path) for path in sorted(gone)), *shapes]

    def _space(self, ref: SpaceRef) -> _Space:
        space = self._spaces.get(ref.name)
        if space is None or space.ref != ref:
            view = SpaceView(self._paths(ref.name), ref.name, _axes(ref))
            space = self._spaces[ref.name] = _Space(ref, view)
        return space

    def _draw_space(self, update: HypothesisUpdate, space: _Space, sources: list[int]) -> list[Shape]:
        dim = space.ref.dim
        everything = update.track_position[np.isin(update.track_source, sources), :dim]
        space.axis = axis_length(everything, space.axis)
        shapes: list[Shape] = []
        ends: list[Positions] = [np.empty((0, 2, dim), np.float32)]
        shades: list[Colours] = [np.empty((0, 3), np.uint8)]
        for number in sources:
            points = _points(update, space, number, self._palette)
            trails = self._trails.setdefault(points.path, Trails())
            session = update.sources[number].session
            moved, segments = trails.step(
                session, update.stamp_ns, points.values["feature"], points.positions
            )
            shapes.append(points)
            ends.append(segments)
            shades.append(points.colours[moved])
        shapes.append(Segments(f"{space.view.path}/trails", np.concatenate(ends), np.concatenate(shades)))
        here = [h for h in update.hypotheses if h.space == space.ref.name and len(h.centroid) == dim]
        shapes += draw_joints(space.view.path, here, update.joints, space.axis, self._palette, self._names)
        return shapes + draw_hypotheses(space.view.path, here, space.axis, self._palette, self._names)


def _points(update: HypothesisUpdate, space: _Space, number: int, palette: Palette) -> Points:
    """The features of one source."""
    rows = update.track_source == number
    return Points(
        space.sources(update.sources[number].name),
        np.nan_to_num(update.track_position[rows, : space.ref.dim]),
        palette.colours(update.track_hypothesis[rows]),
        values={"feature": update.track_id[rows], "confidence": update.track_confidence[rows]},
    )


def _axes(ref: SpaceRef) -> Axes:
    if ref.dim == 2:
        return "y-up" if ref.unit == "m" else "image"
    return "optical" if ref.name.endswith("optical") else "z-up"
