"""The KLT tracker of one camera. Pure: no device, no clock, no I/O.

Steps per frame (thesis, section 4.2):

1. Track every feature by Lucas-Kanade; end those that fail the forward-backward check.
2. Align the templates of the features; end those that no longer match.
3. Lift the features to 3-D where there is depth; end those that jump.
4. Every `respawn_every` frames detect new corners.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import KnownError

from ..calibration.model import Intrinsics
from ..cameras.types import Frame, Image
from .common_motion import common_motion
from .config import TrackerConfig
from .corners import crowded, new_corners
from .depth import BIRTH_RADIUS, LOOKUP_RADIUS, depth_sigma, look_up, point_sigma
from .flow import Pixels, track
from .template import Templates, align, extract, no_templates

Ids = NDArray[np.uint64]
Floats = NDArray[np.float64]

_NOMINAL_PERIOD_NS = 1e9 / 30
_LONGEST_GAP_NS = 0.5e9  # the allowed 3-D step grows with the time since the last point, up to this
_NOISE_DECAY = 0.7  # per frame, of the variance of a feature
_GREY_NOISE = 2.0  # grey levels, one sigma, as in TrackerConfig.birth_sigma


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
    pixel_sigma
        float64 [N], one-sigma noise of `pixels`, px; NaN where it is not known.
    points
        float64 [N, 3] in the optical frame of the camera, m; rows of NaN: no depth in this frame. None
        for a tracker without intrinsics.
    sigma
        float64 [N], isotropic one-sigma noise of `points`, m. None like `points`.
    born
        bool [N], new in this frame.
    ended
        uint64 [M], ended since the frame before.
    """

    stamp_ns: int
    ids: Ids
    pixels: Pixels
    pixel_sigma: Floats
    points: Floats | None
    sigma: Floats | None
    born: NDArray[np.bool_]
    ended: Ids


@dataclass
class _Features:
    """Columns of the current features, oldest first.

    `noise` is the estimated noise in px, `points` the last known point, observed at `seen_ns`,
    `missing` the number of consecutive frames without depth, `lifted` whether this frame gave the point.
    """

    ids: Ids = field(default_factory=lambda: np.empty(0, np.uint64))
    pixels: Pixels = field(default_factory=lambda: np.empty((0, 2), np.float32))
    noise: Floats = field(default_factory=lambda: np.empty(0))
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))
    seen_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    missing: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    lifted: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, bool))
    templates: Templates = field(default_factory=no_templates)

    def select(self, keep: NDArray[np.bool_]) -> "_Features":
        return _Features(**{name: column[keep] for name, column in vars(self).items()})

    def extended(self, new: "_Features") -> "_Features":
        both = {
            name: np.concatenate([column, getattr(new, name)])
            for name, column in vars(self).items()
            if name != "templates"
        }
        return _Features(**both, templates=self.templates.extended(new.templates))


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
        self._features = _Features()
        self._grey: Image | None = None
        self._stamp_ns: int | None = None
        self._frames = 0
        self._next_id = 0

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
            raise KnownError("the image size must not change; reset the tracker first")
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
        ended, self._features = self._features.ids, _Features()
        self._grey, self._stamp_ns, self._frames = None, None, 0
        return ended

    def _follow(self, grey: Image) -> None:
        features = self._features
        if self._grey is None or not len(features.ids):
            return
        flow = track(self._grey, grey, features.pixels, self._config)
        aligned = align(grey, flow.pixels, features.templates, self._config.window)
        strayed = np.abs(aligned.pixels - flow.pixels).max(axis=1) > self._config.anchor_reach
        features.pixels = aligned.pixels
        features.templates = replace(features.templates, shape=aligned.shape)
        noise = np.hypot(flow.noise, aligned.noise)
        features.noise = np.sqrt(_NOISE_DECAY * features.noise**2 + (1 - _NOISE_DECAY) * noise**2)
        features = features.select(flow.kept & ~strayed & (aligned.correlation > self._config.likeness))
        self._features = features.select(~crowded(features.pixels, self._config.min_distance))

    def _lift(self, frame: Frame) -> None:
        """Compute the 3-D points; end features that jump or have no depth for too long."""
        features = self._features
        features.lifted = np.zeros(len(features.ids), bool)
        # A frame without any depth image does not count as missing depth.
        if self._intrinsics is None or frame.depth is None or not len(features.ids):
            return
        z = look_up(frame.depth, features.pixels, self._config, LOOKUP_RADIUS)
        points = self._intrinsics.lift(features.pixels, z)
        features.lifted = np.isfinite(z)
        keep = ~self._jumped(points, z, frame.stamp_ns)
        features.points = np.where(features.lifted[:, None], points, features.points)
        features.seen_ns = np.where(features.lifted, frame.stamp_ns, features.seen_ns)
        features.missing = np.where(features.lifted, 0, features.missing + 1)
        self._features = features.select(keep & (features.missing <= self._config.max_missing))

    def _jumped(self, points: Floats, z: Floats, stamp_ns: int) -> NDArray[np.bool_]:
        """Mask of features whose step since the last known point is longer than allowed."""
        gap = np.clip(stamp_ns - self._features.seen_ns, _NOMINAL_PERIOD_NS, _LONGEST_GAP_NS)
        limit = self._config.max_step * gap / _NOMINAL_PERIOD_NS + 4.0 * depth_sigma(z, self._config)
        last = self._features.points
        if self._config.moving:
            # A longer gap than one frame means another common motion.
            fresh = self._features.seen_ns == self._features.seen_ns.max()
            last = common_motion(last, points, fresh)
        step = np.linalg.norm(points - last, axis=1)
        return np.asarray(step > limit)  # False where there is no point

    def _spawn(self, grey: Image, frame: Frame) -> None:
        depth = frame.depth
        if self._intrinsics is not None and depth is None:
            return

        def usable(pixels: Pixels) -> NDArray[np.bool_]:
            noise = _GREY_NOISE * np.sqrt(extract(grey, pixels, self._config.window).variance_scale)
            chosen = np.asarray(noise < self._config.corner_sigma)
            if self._intrinsics is not None and depth is not None:
                chosen &= np.isfinite(look_up(depth, pixels, self._config, BIRTH_RADIUS))
            return chosen

        pixels = new_corners(grey, self._features.pixels, self._config, usable)
        points = np.full((len(pixels), 3), np.nan)
        if self._intrinsics is not None and depth is not None and len(pixels):
            z = look_up(depth, pixels, self._config, LOOKUP_RADIUS)
            pixels, z = pixels[np.isfinite(z)], z[np.isfinite(z)]
            points = self._intrinsics.lift(pixels, z)
        self._add(grey, pixels, points, frame.stamp_ns)

    def _add(self, grey: Image, pixels: Pixels, points: Floats, stamp_ns: int) -> None:
        count = len(pixels)
        self._features = self._features.extended(
            _Features(
                ids=np.arange(self._next_id, self._next_id + count, dtype=np.uint64),
                pixels=pixels,
                noise=np.zeros(count),
                points=points,
                seen_ns=np.full(count, stamp_ns),
                missing=np.zeros(count, np.int64),
                lifted=np.asarray(np.isfinite(points).all(axis=1)),
                templates=extract(grey, pixels, self._config.window),
            )
        )
        self._next_id += count

    def _tracks(self, stamp_ns: int, kept: int, ended: Ids) -> Tracks:
        features, config = self._features, self._config
        pixel_sigma = np.hypot(config.pixel_sigma, config.residual_gain * features.noise)
        points = sigma = None
        if self._intrinsics is not None:
            points = np.where(features.lifted[:, None], features.points, np.nan)
            sigma = point_sigma(points[:, 2], pixel_sigma, self._intrinsics, config)
        return Tracks(
            stamp_ns=stamp_ns,
            ids=features.ids,
            pixels=features.pixels,
            pixel_sigma=pixel_sigma,
            points=points,
            sigma=sigma,
            born=np.arange(len(features.ids)) >= kept,
            ended=ended,
        )


def _grey(image: Image) -> Image:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
