"""Draws features with their trails and hypotheses: by space and source, and in the images of cameras. Pure.

An image is delayed until the service has fused its instant, so that every feature has the hypothesis of
that instant. Without a service it is shown after 1.5 s with grey features. On request with dense regions.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, HypothesisUpdate, Preview
from comotion_schemas.colours import Palette
from comotion_schemas.naming import Names, named

from ..bodies import poses_in_space
from ..regions import regions
from ..scoring import SpaceRef, spaces_of
from . import drawing
from .drawing import Axes, Eye, Moment, Positions, Shape, SpaceView, Trails, nothing, points, segments
from .hypotheses import BodyDrawing, apart, axis_length
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

    def __init__(self, palette: Palette, names: Names) -> None:
        self._palette, self._names = palette, names
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
        view, up = space.view, _UP[space.view.axes]
        drawn = BodyDrawing(view.path, up, space.axis, self._palette, self._names, view.eye)
        return [*shapes, *drawn.joints(bodies, update.joints), *drawn.bodies(bodies)]


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


MAX_DELAYED = 16
"""Images that are delayed at most; then the oldest is dropped."""
MAX_DELAY_S = 1.5
"""Longest delay of an image."""
_CLASSES = 65535
_ROW_SHARE = 0.08  # height of a label as a share of that of the image
_LABELLED = 3
"""A hypothesis with fewer features in an image gets no label there."""


class Cameras:
    """Delays previews and draws them when they are due.

    The `palette` has seen the updates; `names` are those of hypotheses by id; `dense` draws the regions of
    hypotheses too.

    Attributes
    ----------
    views
        View of every camera that has shown an image, by source.
    """

    def __init__(self, palette: Palette, names: Names, *, dense: bool = False) -> None:
        self._palette, self._names, self._dense = palette, names, dense
        self._paths = Paths("cameras")
        self.views: dict[str, SpaceView] = {}
        self._trails: dict[str, Trails] = {}
        self._held: deque[tuple[float, Preview]] = deque(maxlen=MAX_DELAYED)

    def add(self, preview: Preview, arrived: float) -> None:
        """Add an image."""
        self._held.append((arrived, preview))

    def due(self, update: HypothesisUpdate | None, now: float) -> list[Moment]:
        """Draw the images up to the stamp of the update, and those that have reached the longest delay."""
        moments, waiting = [], []
        for arrived, preview in self._held:
            fused = update is not None and update.stamp_ns >= preview.stamp_ns
            if fused or now - arrived > MAX_DELAY_S:
                moments.append(self._draw(preview, update))
            else:
                waiting.append((arrived, preview))
        self._held.clear()
        self._held.extend(waiting)
        return moments

    def _draw(self, preview: Preview, update: HypothesisUpdate | None) -> Moment:
        name, path = preview.source, self._paths(preview.source)
        self.views.setdefault(name, SpaceView(path, name, "image"))
        hypotheses = _hypotheses(preview, update)
        shades = self._palette.colours(hypotheses)
        trails = self._trails.setdefault(name, Trails())
        moved, ends = trails.step(preview.session, preview.stamp_ns, preview.ids, preview.pixels)
        shapes = [
            drawing.image(f"{path}/image", preview.image),
            drawing.segments(f"{path}/trails", ends, shades[moved]),
            drawing.points(f"{path}/features", preview.pixels, shades, feature=preview.ids),
            self._labels(f"{path}/hypotheses", preview, hypotheses),
        ]
        if self._dense:
            shapes += self._regions(f"{path}/regions", preview, hypotheses)
        # A camera with a wrong clock may have a stamp that the service never reaches.
        newest = preview.stamp_ns if update is None else update.stamp_ns
        return Moment(min(preview.stamp_ns, newest), shapes)

    def _regions(self, path: str, preview: Preview, hypotheses: NDArray[np.uint32]) -> list[Shape]:
        """Regions of the hypotheses; none where the image cannot be read."""
        image = cv2.imdecode(np.frombuffer(preview.image, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            return []
        labels = np.where(hypotheses == UNDETERMINED, -1, hypotheses.astype(np.int64))
        seen = regions(np.asarray(image, np.uint8), preview.pixels, labels)
        # Ids beyond 16 bits share a class; 0 is none.
        classes = np.where(seen >= 0, seen % _CLASSES + 1, 0).astype(np.uint16)
        shown = np.unique(seen[seen >= 0]).tolist()
        colours = self._palette.colours(np.array(shown, np.uint32)).tolist()
        named = {h % _CLASSES + 1: (r, g, b) for h, (r, g, b) in zip(shown, colours, strict=True)}
        return [drawing.regions(path, classes, named)]

    def _labels(self, path: str, preview: Preview, hypotheses: NDArray[np.uint32]) -> Shape:
        """Labels with names or ids of hypotheses at the median position of their features."""
        shown, counts = np.unique(hypotheses[hypotheses != UNDETERMINED], return_counts=True)
        shown = shown[counts >= _LABELLED]
        middles = [np.median(preview.pixels[hypotheses == h], axis=0) for h in shown.tolist()]
        positions = np.array(middles, np.float32).reshape(-1, 2)
        inks = [self._palette.legible(h) for h in shown.tolist()]
        words = [named(h, self._names) for h in shown.tolist()]
        row = _ROW_SHARE * float(np.max(preview.pixels[:, 1], initial=1.0))
        return drawing.labels(path, inks, apart(positions, (0, -1), row), words)


def _hypotheses(preview: Preview, update: HypothesisUpdate | None) -> NDArray[np.uint32]:
    """Look up the hypotheses uint32 [N] of the features of an image."""
    fused = {} if update is None else update.hypotheses_of(preview.source, preview.session)
    return np.array([fused.get(feature, UNDETERMINED) for feature in preview.ids.tolist()], np.uint32)
