"""Finds fiducial markers in an image and their poses. Pure but for the last orientation of each."""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import CameraError, Image

Floats = NDArray[np.float64]

DEFAULT_DICTIONARY = "4x4_50"
_PREFIX = "DICT_"
_AMBIGUITY = 1.5
_LEAST_PIXEL_SIGMA = 0.1


@dataclass(frozen=True)
class MarkerOptions:
    """Which markers to look for: name of the dictionary, edge of the black square in m."""

    size: float
    dictionary: str = DEFAULT_DICTIONARY

    def __post_init__(self) -> None:
        if not (np.isfinite(self.size) and self.size > 0):
            raise CameraError(f"marker size {self.size} m is not above zero")
        find_dictionary(self.dictionary)


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers of one image.

    Attributes
    ----------
    numbers
        uint64 [N], numbers in the dictionary, ascending.
    corners
        float32 [N, 4, 2], px, clockwise from the marker's upper left.
    poses
        [N], marker to camera (optical axes); the marker's z axis leaves its face, x goes right, y up.
    sigma
        float64 [N], isotropic one-sigma noise of the position, m.
    refused
        Markers seen twice in the image, or whose two mirrored poses cannot be told apart.
    """

    numbers: NDArray[np.uint64]
    corners: NDArray[np.float32]
    poses: list[Extrinsics]
    sigma: Floats
    refused: int


def dictionary_names() -> list[str]:
    """List the dictionaries there are, e.g. ``4x4_50`` and ``apriltag_36h11``."""
    return sorted(
        {name.removeprefix(_PREFIX).lower() for name in vars(cv2.aruco) if name.startswith(_PREFIX)}
    )


def find_dictionary(name: str) -> Any:
    """Look up a dictionary of OpenCV by its name, with or without ``DICT_``, in any case.

    Raises
    ------
    CameraError
        If there is none of that name.
    """
    wanted = name.upper().removeprefix(_PREFIX)
    for known, value in vars(cv2.aruco).items():
        if known.startswith(_PREFIX) and known.upper().removeprefix(_PREFIX) == wanted:
            return cv2.aruco.getPredefinedDictionary(value)
    raise CameraError(f"no marker dictionary {name!r}; one of {', '.join(dictionary_names())}")


def make_detector(dictionary: Any) -> Any:
    """Build OpenCV's detector with sub-pixel corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(dictionary, parameters)


@dataclass
class MarkerDetector:
    """Finds the markers of a dictionary, of one size, in the images of one camera.

    A square seen from afar fits two mirrored poses: the better one is taken where it is clearly
    better, else the one next to the marker's last orientation, else none.
    """

    options: MarkerOptions
    intrinsics: Intrinsics
    _last: dict[int, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._detector = make_detector(find_dictionary(self.options.dictionary))
        half = self.options.size / 2
        self._square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])

    def detect(self, image: Image) -> Markers:
        """Find the markers in an image, uint8 [H, W] or [H, W, 3] (BGR)."""
        found, numbers, _ = self._detector.detectMarkers(image)
        flat = np.empty(0, np.int64) if numbers is None else np.asarray(numbers, np.int64).ravel()
        seen: list[tuple[int, NDArray[np.float32], Extrinsics, float]] = []
        for number in np.unique(flat).tolist():
            places = np.flatnonzero(flat == number)
            corners = np.asarray(found[places[0]], np.float32).reshape(4, 2)
            posed = self._pose(number, corners) if len(places) == 1 else None
            if posed is not None:
                seen.append((number, corners, *posed))
        return Markers(
            numbers=np.array([number for number, *_ in seen], np.uint64),
            corners=np.array([corners for _, corners, *_ in seen], np.float32).reshape(-1, 4, 2),
            poses=[pose for *_, pose, _ in seen],
            sigma=np.array([sigma for *_, sigma in seen], np.float64),
            refused=len(np.unique(flat)) - len(seen),
        )

    def _pose(self, number: int, corners: NDArray[np.float32]) -> tuple[Extrinsics, float] | None:
        camera = self.intrinsics
        count, rotations, translations, errors = cv2.solvePnPGeneric(
            self._square, corners, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        candidates = [
            (
                _matrix(rotations[i]),
                np.asarray(translations[i], np.float64).ravel(),
                float(np.ravel(errors[i])[0]),
            )
            for i in range(count)
            if np.isfinite(rotations[i]).all()
            and np.isfinite(translations[i]).all()
            and translations[i][2] > 0
        ]
        if not candidates:
            return None
        best = min(candidates, key=lambda candidate: candidate[2])
        rivals = [c for c in candidates if c[2] < _AMBIGUITY * max(best[2], _LEAST_PIXEL_SIGMA)]
        if len(rivals) > 1:
            last = self._last.get(number)
            if last is None:
                return None
            best = max(rivals, key=lambda candidate: float(np.trace(candidate[0].T @ last)))
        rotation, translation, error = best
        self._last[number] = rotation
        return Extrinsics(rotation, translation, "camera"), self._sigma(corners, translation[2], error)

    def _sigma(self, corners: NDArray[np.float32], z: float, error: float) -> float:
        """First-order noise: the place in the image across the ray, the apparent size along it."""
        pixel = max(error, _LEAST_PIXEL_SIGMA)
        side = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).mean())
        across = pixel * z * 2 / (self.intrinsics.fx + self.intrinsics.fy) / 2  # mean of four corners
        along = z * pixel / side
        return float(np.sqrt((2 * across**2 + along**2) / 3))


def _matrix(rotation_vector: Any) -> Floats:
    return np.asarray(cv2.Rodrigues(rotation_vector)[0], np.float64)
