"""Draws camera images with features in the colours of their hypotheses. Pure.

An image is delayed until the service has fused its instant, so that every feature has the hypothesis of
that instant. Without a service it is shown after 1.5 s with grey features. On request with dense regions.
"""

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, HypothesisUpdate, Preview
from comotion_schemas.colours import Palette
from comotion_schemas.naming import Names, named

from ..regions import regions
from . import drawing
from .drawing import Moment, Shape, SpaceView, Trails
from .hypotheses import apart
from .paths import Paths

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

    Parameters
    ----------
    palette
        Has seen the updates.
    names
        Names of hypotheses by id.
    dense
        Whether to draw the regions of hypotheses too. Needs the extra `dense`.

    Attributes
    ----------
    views
        View of every camera that has shown an image, by source.
    """

    def __init__(
        self, palette: Palette | None = None, names: Names | None = None, *, dense: bool = False
    ) -> None:
        self._palette = palette or Palette()
        self._names_of = {} if names is None else names
        self._dense = dense
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
        words = [named(h, self._names_of) for h in shown.tolist()]
        row = _ROW_SHARE * float(np.max(preview.pixels[:, 1], initial=1.0))
        return drawing.labels(path, inks, apart(positions, (0, -1), row), words)


def _hypotheses(preview: Preview, update: HypothesisUpdate | None) -> NDArray[np.uint32]:
    """Look up the hypotheses uint32 [N] of the features of an image."""
    numbers = np.full(len(preview.ids), UNDETERMINED, np.uint32)
    if update is None:
        return numbers
    sources = [
        k for k, s in enumerate(update.sources) if (s.name, s.session) == (preview.source, preview.session)
    ]
    rows = np.flatnonzero(np.isin(update.track_source, sources))
    _, seen, fused = np.intersect1d(preview.ids, update.track_id[rows], return_indices=True)
    numbers[seen] = update.track_hypothesis[rows[fused]]
    return numbers
