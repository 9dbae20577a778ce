"""Trajectories of a camera, undistorted, at the frames of the bodies' poses."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window
from .camera import CameraModel

# States of a trajectory that are compared, spread over its life.
_STATES = 12
# Three numbers are fitted to the states, of which each has two.
_LEAST_STATES = 4
# px; noise of a feature whose source does not report it. That of a position after many steps is so many times
# the reported one of a step. Tracking drifts and calibration errs by a share of a displacement in the image.
# Chosen on seed 0 of the link experiment, see docs/research/linking.md.
_NOISE, _NOISE_FACTOR, _DRIFT = 0.3, 2.0, 0.02


@dataclass(frozen=True)
class ImageTracks:
    """N image trajectories at up to M of the bodies' frames each, oldest first.

    Attributes
    ----------
    frame
        intp [N, M], index of the frame.
    seen
        bool [N, M]; False pads a trajectory with fewer states.
    position
        float64 [N, M, 2], undistorted, at focal length one.
    variance
        float64 [N], of a coordinate of `position`.
    """

    frame: Ints
    seen: Bools
    position: Floats
    variance: Floats

    def fittable(self) -> Bools:
        """Whether a trajectory has more states than a point needs to be fitted to any, bool [N]."""
        return np.asarray(self.seen.sum(1) >= _LEAST_STATES)


def sample_tracks(window: Window, slots: Slots, stamps: Stamps, camera: CameraModel) -> ImageTracks:
    """States of trajectories at up to twelve of the frames each.

    Linear between observations, never across a gap longer than the window allows.

    Parameters
    ----------
    window
        Of the camera's space.
    slots
        intp [N].
    stamps
        int64 [F] ns, ascending; the frames.
    camera
        Calibration.
    """
    count = len(slots)
    states = states_at(window, slots, stamps)
    frame = np.zeros((count, _STATES), np.intp)
    seen = np.zeros((count, _STATES), np.bool_)
    noise = np.zeros(count)
    for n, slot in enumerate(slots.tolist()):
        chosen = _thinned(np.flatnonzero(states.held[:, n]))
        frame[n, : len(chosen)], seen[n, : len(chosen)] = chosen, True
        sigma = window.held(window.sigma, slot)
        reported = sigma[np.isfinite(sigma)]
        noise[n] = np.median(reported) if len(reported) else _NOISE
    pixels = np.where(seen[..., None], states.position[frame, np.arange(count)[:, None]], 0.0)
    extent = _extent(pixels, seen)
    return ImageTracks(
        frame=frame,
        seen=seen,
        position=camera.normalised(pixels.reshape(-1, 2)).reshape(count, _STATES, 2),
        variance=((_NOISE_FACTOR * noise) ** 2 + (_DRIFT * extent) ** 2) / camera.focal**2,
    )


def _thinned(frames: Ints) -> Ints:
    """At most :data:`_STATES` of the frames, evenly spread."""
    if len(frames) <= _STATES:
        return frames
    return frames[np.round(np.linspace(0, len(frames) - 1, _STATES)).astype(np.intp)]


def _extent(pixels: Floats, seen: Bools) -> Floats:
    """Root mean square distance of each trajectory's states from their mean, float64 [N] px."""
    count = np.maximum(seen.sum(1), 1)
    mean = (pixels * seen[..., None]).sum(1) / count[:, None]
    squared = ((pixels - mean[:, None]) ** 2).sum(2) * seen
    return np.asarray(np.sqrt(squared.sum(1) / count))
