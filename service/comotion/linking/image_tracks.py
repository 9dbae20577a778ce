"""Calibrated cameras, and their trajectories, undistorted, at the frames of the bodies' poses."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..config import Camera
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window

# States of a trajectory that are compared, spread over its life.
_STATES = 12
# px; noise of a feature whose source does not report it. That of a position after many steps is so many times
# the reported one of a step. Tracking drifts and calibration errs by a share of a displacement in the image.
# Chosen on seed 0 of the link experiment, see docs/research/linking.md.
_NOISE, _NOISE_FACTOR, _DRIFT = 0.3, 2.0, 0.02


class CameraModel:
    """A calibrated camera that does not move.

    Attributes
    ----------
    frame
        The metric space that the extrinsics lead to.
    rotation, translation
        float64 [3, 3] and [3] (m), camera to `frame`.
    focal
        px; geometric mean of the focal lengths.
    """

    def __init__(self, camera: Camera) -> None:
        self.frame = camera.frame
        self.rotation: Floats = Rotation.from_quat(camera.quaternion).as_matrix()
        self.translation: Floats = np.asarray(camera.translation)
        self.focal = math.sqrt(camera.fx * camera.fy)
        self._matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        self._distortion = np.array(camera.distortion) if any(camera.distortion) else None
        if self._distortion is not None:
            import cv2  # noqa: F401, PLC0415 - takes a while: now rather than during an update

    def normalised(self, pixels: Floats) -> Floats:
        """Undistorted image coordinates at focal length one, float64 [N, 2], of pixels float64 [N, 2]."""
        if self._distortion is not None and len(pixels):
            import cv2  # noqa: PLC0415 - slow to import, and few cameras need it

            flat = cv2.undistortPoints(pixels[:, None], self._matrix, self._distortion)
            return np.asarray(flat.reshape(-1, 2), np.float64)
        return np.asarray((pixels - self._matrix[:2, 2]) / self._matrix.diagonal()[:2], np.float64)


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
    states = states_at(window, slots, stamps)
    # The frames of each with a state come first, of which some are taken, evenly spread.
    order, count = np.argsort(~states.held.T, axis=1, kind="stable"), states.held.sum(0)[:, None]
    place = np.arange(_STATES)
    spread = np.round(place * np.maximum(count - 1, 0) / (_STATES - 1)).astype(np.intp)
    seen = place < count
    frame = np.where(seen, np.take_along_axis(order, np.where(count > _STATES, spread, place * seen), 1), 0)
    pixels = np.where(seen[..., None], states.position[frame, np.arange(len(slots))[:, None]], 0.0)
    taken = np.maximum(seen.sum(1), 1)
    centred = pixels - pixels.sum(1, keepdims=True) / taken[:, None, None]
    extent = ((centred**2).sum(2) * seen).sum(1) / taken
    noise = np.array([_noise(window.held(window.sigma, slot)) for slot in slots.tolist()])
    return ImageTracks(
        frame=frame,
        seen=seen,
        position=camera.normalised(pixels.reshape(-1, 2)).reshape(*seen.shape, 2),
        variance=((_NOISE_FACTOR * noise) ** 2 + _DRIFT**2 * extent) / camera.focal**2,
    )


def _noise(sigma: Floats) -> float:
    """Noise of a feature, px, by what its source reports, float64 [m]."""
    reported = sigma[np.isfinite(sigma)]
    return float(np.median(reported)) if len(reported) else _NOISE
