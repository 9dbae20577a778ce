"""The KLT tracker of one camera. Pure: no device, no clock, no I/O.

Steps per frame (thesis, section 4.2):

1. Track every feature by Lucas-Kanade; end those that fail the forward-backward check.
2. Align the templates of the features; end those that no longer match, and those that slide.
3. Lift the features to 3-D where there is depth; end those without depth for too long.
4. Every `respawn_every` frames detect new corners.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import KnownError

from ..calibration.model import Intrinsics
from ..cameras.types import Frame, Image
from .config import TrackerConfig
from .depth import look_up, point_sigma
from .template import Columns, Pixels, Templates, align, extract, is_upright, likeness

Ids = NDArray[np.uint64]
Floats = NDArray[np.float64]

_GREY_NOISE = 2.0  # grey levels, one sigma, as in TrackerConfig.birth_sigma
# Corners that are examined at once: OpenCV samples 32 766 at most, and an image of 4K may have more.
_EXAMINED = 8192


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """The features of one frame.

    Attributes
    ----------
    stamp_ns
        Acquisition time of the frame.
    ids
        uint64 [N], ascending; a tracker never reuses an id.
    pixels
        float32 [N, 2], px.
    positions
        float64 [N, 3] in the optical frame of the camera, m; rows of NaN: no depth in this frame. Without
        intrinsics `pixels`, float64 [N, 2].
    sigma
        float64 [N], isotropic one-sigma noise of `positions`; NaN where it is not known.
    born
        bool [N], new in this frame.
    ended
        uint64 [M], ended since the frame before.
    """

    stamp_ns: int
    ids: Ids
    pixels: Pixels
    positions: Floats
    sigma: Floats
    born: NDArray[np.bool_]
    ended: Ids


@dataclass
class _Features(Columns):
    """Columns of the current features, oldest first.

    `birth` is the place of the template, px; `points` are NaN without depth in this frame, `missing` is the
    number of consecutive frames without depth.
    """

    ids: Ids
    birth: Pixels
    pixels: Pixels
    points: Floats
    missing: NDArray[np.int64]
    templates: Templates


class Tracker:
    """Tracks features through the frames of one camera.

    Parameters
    ----------
    config
        Parameters.
    intrinsics
        For lifting to 3-D; every frame should then have depth. None: image coordinates only.
    """

    def __init__(self, config: TrackerConfig | None = None, intrinsics: Intrinsics | None = None) -> None:
        self._config = config or TrackerConfig()
        self._intrinsics = intrinsics
        self._next_id = 0
        nowhere = np.empty((0, 2), np.float32)
        templates = extract(np.zeros((1, 1), np.uint8), nowhere, self._config.window)
        self._features = self._born(nowhere, np.empty((0, 3)), templates)
        self._grey: Image | None = None
        self._stamp_ns: int | None = None
        self._frames = 0

    @property
    def count(self) -> int:
        """Number of features so far, including ended ones."""
        return self._next_id

    def step(self, frame: Frame) -> Tracks:
        """Track all features into the next frame.

        Raises
        ------
        ValueError
            If the frame is not newer than the one before, or has another size.
        """
        if self._stamp_ns is not None and frame.stamp_ns <= self._stamp_ns:
            raise KnownError("frames must come in order of their stamps")
        if self._grey is not None and frame.image.shape[:2] != self._grey.shape:
            sizes = [f"{width} x {height}" for height, width in (frame.image.shape[:2], self._grey.shape)]
            raise KnownError(f"an image of {sizes[0]} px follows one of {sizes[1]}; all need one size")
        grey = _grey(frame.image)
        earlier_ids = self._features.ids
        self._follow(grey)
        self._lift(frame)
        kept = len(self._features.ids)
        ended = np.setdiff1d(earlier_ids, self._features.ids, assume_unique=True)
        if self._frames % self._config.respawn_every == 0:
            self._spawn(grey, frame)
        self._frames += 1
        self._grey, self._stamp_ns = grey, frame.stamp_ns
        return self._tracks(frame.stamp_ns, kept, ended)

    def reset(self) -> Ids:
        """End all features, as after a cut, and return their ids."""
        ended, self._features = self._features.ids, self._features[np.zeros(len(self._features.ids), bool)]
        self._grey, self._stamp_ns, self._frames = None, None, 0
        return ended

    def _follow(self, grey: Image) -> None:
        features = self._features
        if self._grey is None or not len(features.ids):
            return
        pixels, kept = track(self._grey, grey, features.pixels, self._config)
        features.pixels, shape, correlation = align(grey, pixels, features.templates, self._config.window)
        features.templates = replace(features.templates, shape=shape)
        kept &= (correlation > self._config.likeness) & is_upright(shape)
        kept[kept] = ~self._slid(grey, features[kept])
        self._features = features[kept]

    def _slid(self, grey: Image, features: _Features) -> NDArray[np.bool_]:
        """Which features have moved, while the image shows them where they were born as well.

        What moves leaves its place: a straight edge goes on there, and they have gone along it.
        """
        away = np.linalg.norm(features.pixels - features.birth, axis=1) > self._config.window / 2
        if not away.any():
            return np.asarray(away)
        left = features[away]
        away[away] = likeness(grey, left.birth, left.templates, self._config.window) > self._config.likeness
        return np.asarray(away)

    def _lift(self, frame: Frame) -> None:
        """Compute the 3-D points; end features that have no depth for too long."""
        features = self._features
        features.points = self._points(frame, features.pixels)
        # A frame without any depth image does not count as missing depth.
        if self._intrinsics is not None and frame.depth is not None:
            features.missing = np.where(np.isnan(features.points[:, 2]), features.missing + 1, 0)
            self._features = features[features.missing <= self._config.max_missing]

    def _points(self, frame: Frame, pixels: Pixels) -> Floats:
        if self._intrinsics is None or frame.depth is None:
            return np.full((len(pixels), 3), np.nan)
        return self._intrinsics.lift(pixels, look_up(frame.depth, pixels, self._config))

    def _spawn(self, grey: Image, frame: Frame) -> None:
        if self._intrinsics is not None and frame.depth is None:
            return
        corners = new_corners(grey, self._features.pixels, self._config)
        free = self._config.max_features - len(self._features.ids)
        free = min(free, self._config.spawn_limit or free)
        for start in range(0, len(corners), _EXAMINED):
            pixels = corners[start : start + _EXAMINED]
            templates = extract(grey, pixels, self._config.window)
            noise = _GREY_NOISE * np.sqrt(templates.variance_scale)
            points = self._points(frame, pixels)
            lifted = np.isfinite(points[:, 2]) | (self._intrinsics is None)
            chosen = np.flatnonzero((noise < self._config.corner_sigma) & lifted)[:free]
            self._features += self._born(pixels[chosen], points[chosen], templates[chosen])
            free -= len(chosen)
            if free <= 0:
                break

    def _born(self, pixels: Pixels, points: Floats, templates: Templates) -> _Features:
        first, count = self._next_id, len(pixels)
        self._next_id += count
        return _Features(
            ids=np.arange(first, first + count, dtype=np.uint64),
            birth=pixels,
            pixels=pixels,
            points=points,
            missing=np.zeros(count, np.int64),
            templates=templates,
        )

    def _tracks(self, stamp_ns: int, kept: int, ended: Ids) -> Tracks:
        features, config = self._features, self._config
        positions, sigma = features.pixels.astype(np.float64), np.full(len(features.ids), config.pixel_sigma)
        if self._intrinsics is not None:
            positions = features.points
            sigma = point_sigma(positions[:, 2], self._intrinsics, config)
        return Tracks(
            stamp_ns=stamp_ns,
            ids=features.ids,
            pixels=features.pixels,
            positions=positions,
            sigma=sigma,
            born=np.arange(len(features.ids)) >= kept,
            ended=ended,
        )


def _grey(image: Image) -> Image:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def track(
    earlier: Image, later: Image, pixels: Pixels, config: TrackerConfig
) -> tuple[Pixels, NDArray[np.bool_]]:
    """Track features from one grey image to the next and back.

    A feature is kept while ‖w + ŵ‖² < relative·(‖w‖² + ‖ŵ‖²) + absolute, with w = x_{t+1} − x_t and
    ŵ = x̂_t − x_{t+1} (thesis 4.2, after Sundaram, Brox and Keutzer 2010). The thesis prints this inequality
    for "stop", and x̂_t − x_t as ŵ; both are errata.

    Parameters
    ----------
    earlier, later
        uint8 [H, W], of the same size.
    pixels
        float32 [N, 2], positions in `earlier`.

    Returns
    -------
    float32 [N, 2], positions in `later`; bool [N], kept.
    """
    forward, tracked = _lucas_kanade(earlier, later, pixels, config)
    back, tracked_back = _lucas_kanade(later, earlier, forward, config)
    moved = ((forward - pixels) ** 2).sum(axis=1) + ((back - forward) ** 2).sum(axis=1)
    kept = ((back - pixels) ** 2).sum(axis=1) < config.fb_relative * moved + config.fb_absolute
    return forward, kept & tracked & tracked_back & inside(forward, later.shape, config.window // 2)


def _lucas_kanade(
    start: Image, end: Image, pixels: Pixels, config: TrackerConfig
) -> tuple[Pixels, NDArray[np.bool_]]:
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, config.iterations, config.epsilon)
    window, points = (config.window, config.window), np.ascontiguousarray(pixels[:, None])
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        start, end, points, np.empty_like(points), winSize=window, maxLevel=config.levels, criteria=criteria
    )
    positions = moved.reshape(-1, 2)
    # OpenCV leaves arbitrary numbers for a lost feature; replace them.
    tracked = (status.ravel() == 1) & np.isfinite(positions).all(axis=1)
    return np.where(tracked[:, None], positions, pixels).astype(np.float32), tracked


def inside(pixels: NDArray[Any], shape: tuple[int, ...], border: int) -> NDArray[np.bool_]:
    """Mask of pixels [N, 2] at least `border` px away from the border of an image of a shape."""
    height, width = shape[:2]
    x, y = pixels[:, 0], pixels[:, 1]
    return (x >= border) & (y >= border) & (x <= width - 1 - border) & (y <= height - 1 - border)


def new_corners(grey: Image, present: Pixels, config: TrackerConfig) -> Pixels:
    """Find corners that keep a distance from the features and from each other, float32 [M, 2], best first.

    Parameters
    ----------
    grey
        uint8 [H, W].
    present
        float32 [N, 2], existing features.
    config
        Distance and quality.
    """
    taken = np.zeros(grey.shape, np.uint8)
    for place in np.rint(present).astype(int).tolist():
        cv2.circle(taken, place, config.distance, 1, -1)
    corners = cv2.goodFeaturesToTrack(grey, 0, config.quality, config.distance)
    pixels = np.empty((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
    free = taken[tuple(pixels.astype(int).T[::-1])] == 0
    return np.asarray(pixels[free & inside(pixels, grey.shape, config.window // 2 + 1)], np.float32)
