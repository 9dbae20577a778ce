"""What a camera saw of its features, at the frames at which the bodies' poses are known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Slots, Stamps
from ..trajectories.window import Window
from .camera import CameraModel

# A trajectory says how it moves by so many states, spread over its life.
STATES = 12
# Three numbers are fitted to the states, of which each has two.
_LEAST_STATES = 4
# px; noise of a feature whose source does not tell.
_NOISE = 0.3
# A tracker tells the noise of a step; its place after many steps is worse.
_STEPS = 2.0
# Share of a trajectory's displacement in the image by which tracking drifts and calibration errs.
_DRIFT = 0.02


@dataclass(frozen=True)
class Sightings:
    """N image trajectories at up to M of the bodies' frames each, oldest first.

    Attributes
    ----------
    frame
        intp [N, M], index of the frame.
    seen
        bool [N, M]; False pads a trajectory with fewer states.
    place
        float64 [N, M, 2], undistorted, at focal length one.
    variance
        float64 [N], of a coordinate of `place`.
    """

    frame: NDArray[np.intp]
    seen: Bools
    place: Floats
    variance: Floats

    def enough(self) -> Bools:
        """Whether a trajectory has more states than a point needs to be fitted to any, bool [N]."""
        return np.asarray(self.seen.sum(1) >= _LEAST_STATES)


def sight(window: Window, slots: Slots, stamps: Stamps, camera: CameraModel) -> Sightings:
    """States of trajectories (slots intp [N]) at up to :data:`STATES` of the frames int64 [F].

    Linear between observations, never across a gap longer than the window allows.
    """
    count = len(slots)
    frame = np.zeros((count, STATES), np.intp)
    seen = np.zeros((count, STATES), np.bool_)
    pixels = np.zeros((count, STATES, 2))
    noise = np.zeros(count)
    for n, slot in enumerate(slots.tolist()):
        series = window.series(slot)
        chosen = _chosen(series.times, stamps, window.gap_ns)
        frame[n, : len(chosen)], seen[n, : len(chosen)] = chosen, True
        since = (stamps[chosen] - series.times[0]) * 1e-9
        at = (series.times - series.times[0]) * 1e-9
        for axis in range(2):
            pixels[n, : len(chosen), axis] = np.interp(since, at, series.positions[:, axis])
        told = series.sigma[np.isfinite(series.sigma)]
        noise[n] = np.median(told) if len(told) else _NOISE
    moved = _spread(pixels, seen)
    return Sightings(
        frame=frame,
        seen=seen,
        place=camera.normalised(pixels.reshape(-1, 2)).reshape(count, STATES, 2),
        variance=((_STEPS * noise) ** 2 + (_DRIFT * moved) ** 2) / camera.focal**2,
    )


def _chosen(times: Stamps, stamps: Stamps, gap_ns: int) -> NDArray[np.intp]:
    """Frames at which a trajectory has a state, thinned evenly to :data:`STATES`."""
    right = np.clip(np.searchsorted(times, stamps), 1, max(len(times) - 1, 1))
    inside = (stamps >= times[0]) & (stamps <= times[-1])
    if len(times) > 1:
        inside &= times[right] - times[right - 1] <= gap_ns
    found = np.flatnonzero(inside)
    if len(found) <= STATES:
        return found
    return found[np.round(np.linspace(0, len(found) - 1, STATES)).astype(np.intp)]


def _spread(pixels: Floats, seen: Bools) -> Floats:
    """Root mean square distance of each trajectory's states from their mean, float64 [N]."""
    count = np.maximum(seen.sum(1), 1)
    mean = (pixels * seen[..., None]).sum(1) / count[:, None]
    squared = ((pixels - mean[:, None]) ** 2).sum(2) * seen
    return np.asarray(np.sqrt(squared.sum(1) / count))
