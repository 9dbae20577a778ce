"""Finds fiducial markers and their poses in an image, and publishes them as a separate, metric source."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Unpack

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas.component import Where
from comotion_schemas.errors import InputError

from .calibration.model import Extrinsics, Intrinsics
from .cameras.types import Frame, Image
from .runtime import SourcePublisher

Floats = NDArray[np.float64]

DEFAULT_DICTIONARY = "4x4_50"
_PREFIX = "DICT_"
_AMBIGUITY = 1.5  # two poses whose reprojection errors differ by less than this factor are ambiguous
_FAILED_PX = 2.0
"""A reprojection error above this means that IPPE failed; corners are found to a few tenths of a pixel."""
_MIN_ERROR_PX = 0.1  # smaller reprojection errors do not distinguish poses
# Sub-pixel corners of a square are 0.2 to 0.4 px inside it, at every distance (measured on rendered
# markers). The reprojection error does not show this bias, but the distance has it.
_CORNER_SIGMA_PX = 0.3


@dataclass(frozen=True)
class MarkerOptions:
    """The markers to detect: edge of the black square in m, name of the dictionary."""

    size: float
    dictionary: str = DEFAULT_DICTIONARY

    def __post_init__(self) -> None:
        if not (np.isfinite(self.size) and self.size > 0):
            raise InputError(f"marker size {self.size} m is not above zero")
        find_dictionary(self.dictionary)


def find_dictionary(name: str) -> Any:
    """Look up an OpenCV dictionary by its name, with or without ``DICT_``, ignoring case.

    Raises
    ------
    InputError
        If there is no dictionary of that name.
    """
    numbers = {
        key.removeprefix(_PREFIX).lower(): n for key, n in vars(cv2.aruco).items() if key.startswith(_PREFIX)
    }
    number = numbers.get(name.upper().removeprefix(_PREFIX).lower())
    if number is None:
        raise InputError(f"no marker dictionary {name!r}; one of {', '.join(sorted(numbers))}")
    return cv2.aruco.getPredefinedDictionary(number)


def make_detector(dictionary: Any) -> Any:
    """Build an OpenCV detector with sub-pixel corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def outlines(detector: Any, image: Image) -> dict[int, NDArray[np.float32] | None]:
    """Corners [4, 2], px, of markers in an image by their number, ascending; None where it occurs twice."""
    corners, numbers, _ = detector.detectMarkers(image)
    flat = [] if numbers is None else np.ravel(numbers).tolist()
    by_number = {
        number: np.asarray(four, np.float32).reshape(4, 2) for number, four in zip(flat, corners, strict=True)
    }
    return {number: by_number[number] if flat.count(number) == 1 else None for number in sorted(by_number)}


def corners_of(size: float) -> Floats:
    """Corners of a marker by its edge in m, float64 [4, 3]: clockwise from the upper left, x right, y up."""
    return size / 2 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def planar_poses(camera: Intrinsics, points: Floats, pixels: Floats) -> list[tuple[float, Extrinsics]]:
    """Find the poses (target to camera) that fit the image of a flat target, best first.

    Parameters
    ----------
    camera
        Intrinsics of the camera.
    points
        float64 [M, 3], M >= 4, points of the target with z = 0, in m.
    pixels
        float64 [M, 2], the same points in the image.

    Returns
    -------
    At most three pairs: root mean square reprojection error in px, and pose. None is behind the camera.
    """
    poses: list[tuple[float, Extrinsics]] = []
    # OpenCV's IPPE fails where the symmetry axis of the target meets the optical axis: reprojection
    # errors of 20 to 80 px for exact corners (5 of 216 poses; IPPE_SQUARE: 11 of 216).
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_ITERATIVE):
        _, *solutions = cv2.solvePnPGeneric(points, pixels, camera.matrix, camera.distortion, flags=method)
        for turn, shift, error in zip(*solutions, strict=True):
            values = np.concatenate([turn, shift, error], axis=None).astype(np.float64)
            if np.isfinite(values).all() and values[5] > 0:
                pose = Extrinsics(Rotation.from_rotvec(values[:3]).as_matrix(), values[3:6])
                # OpenCV's error is that of a coordinate.
                poses.append((np.sqrt(2) * float(values[6]), pose))
        poses.sort(key=lambda candidate: candidate[0])
        if poses and poses[0][0] <= _FAILED_PX:
            break
    return poses


@dataclass
class MarkerDetector:
    """Detects the markers of one dictionary and size in the images of one camera.

    A distant square fits two mirrored poses. The detector takes the pose with the clearly smaller error,
    or else the one closest to the last orientation of the marker. Without a last orientation it
    refuses the marker.
    """

    options: MarkerOptions
    intrinsics: Intrinsics
    _last: dict[int, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._detector = make_detector(find_dictionary(self.options.dictionary))
        self._square = corners_of(self.options.size)

    def detect(self, image: Image) -> dict[int, tuple[Extrinsics, float] | None]:
        """Find the markers in an image, uint8 [H, W] or [H, W, 3] (BGR).

        Returns
        -------
        By number, ascending: the pose from marker to camera (optical axes; marker axes: x right, y up, z out
        of its face), and the isotropic one-sigma noise of its position, m. None for a marker that occurs
        twice or whose two mirrored poses are ambiguous.
        """
        markers = outlines(self._detector, image)
        return {n: None if corners is None else self._pose(n, corners) for n, corners in markers.items()}

    def _pose(self, number: int, corners: NDArray[np.float32]) -> tuple[Extrinsics, float] | None:
        candidates = planar_poses(self.intrinsics, self._square, corners.astype(np.float64))
        if not candidates:
            return None
        error, best = candidates[0]
        similar = [pose for e, pose in candidates if e < _AMBIGUITY * max(error, _MIN_ERROR_PX)]
        if len(similar) > 1:
            last = self._last.get(number)
            if last is None:
                return None
            best = max(similar, key=lambda pose: float(np.trace(pose.rotation.T @ last)))
        self._last[number] = best.rotation
        # First-order noise: image position gives the axes across the ray, apparent size the one along.
        pixel, z = max(error, _CORNER_SIGMA_PX), best.translation[2]
        side = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).mean())
        across = pixel * z * 2 / (self.intrinsics.fx + self.intrinsics.fy) / 2  # mean of four corners
        along = z * pixel / side
        sigma = float(np.sqrt((2 * across**2 + along**2) / 3))
        return Extrinsics(best.rotation, best.translation, "camera"), sigma


def publish_markers(
    stack: ExitStack,
    name: str,
    markers: MarkerOptions,
    intrinsics: Intrinsics | None,
    extrinsics: Extrinsics,
    *,
    rate: float,
    **where: Unpack[Where],
) -> Callable[[Frame, object], None]:
    """Return what publishes the poses of the markers in a frame; an empty batch if there are none.

    The empty batch keeps the watermark of the scene moving. Poses are in the target frame of the extrinsics
    of the camera. The source is open as long as the stack.

    Raises
    ------
    InputError
        If there are no intrinsics.
    """
    if intrinsics is None:
        raise InputError("markers need the camera's intrinsics: --calibration FILE")
    detector = MarkerDetector(markers, intrinsics)
    text = f"{markers.dictionary} markers of {markers.size:g} m"
    source = stack.enter_context(
        SourcePublisher(name, space=extrinsics.frame, unit="m", dim=3, rate=rate, message=text, **where)
    )

    def publish(frame: Frame, _tracks: object) -> None:
        detected = detector.detect(frame.image)
        seen = {number: pose for number, pose in detected.items() if pose is not None}
        poses = [extrinsics.after(pose) for pose, _ in seen.values()]
        source.count("refused", len(detected) - len(seen))
        source.name_features({number: f"marker {number}" for number in seen})
        source.observe(
            stamp_ns=frame.stamp_ns,
            ids=np.array(list(seen), np.uint64),
            positions=np.array([pose.translation for pose in poses]).reshape(-1, 3),
            quaternions=[pose.quaternion for pose in poses] or None,
            sigma=[sigma for _, sigma in seen.values()] or None,
        )

    return publish
