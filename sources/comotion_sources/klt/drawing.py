"""Draws features in the colours of their hypotheses into images, with ids, boxes and a legend."""

from collections import deque
from collections.abc import Callable, Sequence
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, Hypothesis
from comotion_schemas.colours import BACKGROUND, Palette
from comotion_schemas.naming import Names, named
from comotion_schemas.rigid import matrix

from ..cameras.types import Image
from .observer import CameraSpace
from .tracker import Tracks

_DIMMED = 0.55  # share of its brightness that the image keeps
_TAIL = 10  # frames
_RADIUS = 4  # px
_RIM = (0, 0, 0)
_PAPER = (255, 255, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_ID_SCALE, _LEGEND_SCALE = 0.8, 0.45
_ROW = 18  # px
_LEGEND_ROWS = 12
# A hypothesis with fewer features in the image has neither id nor box there.
_SHOWN = 3
# Share of the features of a body that may be above its id: a wrong one would take it along.
_TOP = 0.05

BGR = tuple[int, int, int]


class Annotator:
    """Draws features, their recent paths, and the ids and boxes of bodies into dimmed images.

    Boxes that are not in `space` are not drawn; `names` are those of hypotheses by id.
    """

    def __init__(self, space: CameraSpace | None = None, names: Names | None = None) -> None:
        self._space, self._names = space, names or {}
        self._palette = Palette()
        self._tails: dict[int, deque[tuple[int, int]]] = {}

    def draw(
        self,
        image: Image,
        tracks: Tracks,
        hypothesis: Callable[[int], int],
        hypotheses: Sequence[Hypothesis] = (),
    ) -> Image:
        """Return a copy of an image with the features of its frame.

        The `image` is uint8 [H, W, 3] BGR, or [H, W]; `hypothesis` maps a feature id to its hypothesis, and
        `hypotheses` are all that the update of this frame lists.
        """
        self._palette.see(hypotheses)
        colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
        canvas = np.asarray(cv2.convertScaleAbs(colour, alpha=_DIMMED), np.uint8)
        labels = np.array([hypothesis(feature) for feature in tracks.ids.tolist()], np.uint32)
        listed = {h.id: h for h in hypotheses}
        bodies = self._bodies(tracks, labels)
        for number in bodies:
            if number in listed and listed[number].state != "static":
                self._draw_box(canvas, listed[number])
        self._draw_features(canvas, tracks, labels)
        for number, place in bodies.items():
            _write_above(canvas, named(number, self._names), place, self._bgr(number))
        self._draw_legend(canvas, labels, listed)
        return canvas

    def _bgr(self, hypothesis: int) -> BGR:
        red, green, blue = self._palette.colour(hypothesis)
        return blue, green, red

    def _bodies(self, tracks: Tracks, labels: NDArray[np.uint32]) -> dict[int, tuple[int, int]]:
        """Hypotheses that are seen, without the background, and where most of their features begin, px."""
        shown, counts = np.unique(labels[labels != UNDETERMINED], return_counts=True)
        tops = {}
        for number in shown[counts >= _SHOWN].tolist():
            if self._palette.colour(number) != BACKGROUND:
                across, down = tracks.pixels[labels == number].T
                tops[number] = (round(float(np.median(across))), round(float(np.quantile(down, _TOP))))
        return tops

    def _draw_features(self, canvas: Image, tracks: Tracks, labels: NDArray[np.uint32]) -> None:
        places = np.rint(tracks.pixels).astype(int).tolist()
        tails = {}
        for feature, label, (x, y) in zip(tracks.ids.tolist(), labels.tolist(), places, strict=True):
            tail = self._tails.get(feature) or deque(maxlen=_TAIL)
            tail.append((x, y))
            tails[feature] = tail
            shade = self._bgr(label)
            cv2.polylines(canvas, [np.array(tail, np.int32)], False, shade, 2, cv2.LINE_AA)
            radius = _RADIUS if label != UNDETERMINED else _RADIUS - 2
            cv2.circle(canvas, (x, y), radius + 1, _RIM, -1, cv2.LINE_AA)
            cv2.circle(canvas, (x, y), radius, shade, -1, cv2.LINE_AA)
        self._tails = tails

    def _draw_box(self, canvas: Image, body: Hypothesis) -> None:
        if self._space is None or body.box is None or body.space != self._space.name:
            return
        box, dim = body.box, len(body.box.center)
        # The bits of the index of a corner are its sides; an edge changes one.
        sides = np.array([[1 if k >> d & 1 else -1 for d in range(dim)] for k in range(2**dim)], np.float64)
        corners = np.asarray(sides * box.half @ matrix(box.rotation).T + box.center)
        edges = [(a, b) for a, b in combinations(range(2**dim), 2) if (a ^ b).bit_count() == 1]
        places = _pixels(corners, self._space)
        if places is None:
            return
        limit = 4 * max(canvas.shape)
        places = np.clip(places, -limit, limit)
        for a, b in edges:
            ends = [tuple(np.rint(places[k]).astype(int).tolist()) for k in (a, b)]
            cv2.line(canvas, ends[0], ends[1], self._bgr(body.id), 1, cv2.LINE_AA)

    def _draw_legend(self, canvas: Image, labels: NDArray[np.uint32], listed: dict[int, Hypothesis]) -> None:
        shown, counts = np.unique(labels, return_counts=True)
        order = np.argsort(-counts, kind="stable")[:_LEGEND_ROWS]
        rows = []
        for k in order.tolist():
            number = int(shown[k])
            body = listed.get(number)
            name = f"{named(number, self._names)} {body.state if body else ''}"
            name = "undetermined" if number == UNDETERMINED else name
            rows.append((self._bgr(number), f"{name.strip()}, {counts[k]}"))
        if not rows:
            return
        width = 24 + max(cv2.getTextSize(text, _FONT, _LEGEND_SCALE, 1)[0][0] for _, text in rows) + 8
        panel = canvas[4 : 4 + _ROW * len(rows) + 6, 4 : 4 + width]
        panel[:] = panel // 3
        for k, (shade, text) in enumerate(rows):
            y = 4 + _ROW * k + 12
            cv2.circle(canvas, (16, y), 5, shade, -1, cv2.LINE_AA)
            cv2.putText(canvas, text, (28, y + 5), _FONT, _LEGEND_SCALE, _PAPER, 1, cv2.LINE_AA)


def _write_above(canvas: Image, text: str, place: tuple[int, int], shade: BGR) -> None:
    """Write a text in the middle above a place, within the image."""
    (across, up), _ = cv2.getTextSize(text, _FONT, _ID_SCALE, 2)
    left = min(max(place[0] - across // 2, 2), max(canvas.shape[1] - across - 2, 2))
    corner = left, max(place[1] - 2 * _RADIUS, up + 2)
    for colour, width in ((_RIM, 6), (shade, 2)):
        cv2.putText(canvas, text, corner, _FONT, _ID_SCALE, colour, width, cv2.LINE_AA)


def _pixels(points: NDArray[np.float64], space: CameraSpace) -> NDArray[np.float64] | None:
    """Points of the space [n, 2 or 3] in the image [n, 2]; None where one is not before the camera."""
    if points.shape[1] == 2:
        return points
    if space.intrinsics is None:
        return None
    seen = points if space.extrinsics is None else space.extrinsics.inverse().apply(points)
    if (seen[:, 2] < 0.05).any():
        return None
    return np.asarray(space.intrinsics.project(seen), np.float64)
