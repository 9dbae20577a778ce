"""Reads ``.npz`` recordings.

Arrays: ``positions`` (F, N, 2 or 3) with NaN where unobserved, and ``times`` (F,) in seconds, as datetime64,
or as whole numbers of ms, us or ns. Optional: ``labels`` (N,), number of the true object from 1 on;
``segment_names`` or ``label_names``; ``units`` (``m``, ``cm`` or ``mm``; m by default). Positions with two
coordinates are in pixels.

Files without ``positions`` are read as those of a point tracker (:mod:`.tracks`).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import RecordingError

from ..streams import AMBIGUOUS
from . import Recording
from .tracks import NAMES, tracks_recording

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# Two hours of 100 markers at 100 Hz take 1.7 GB.
_MAX_BYTES = 2 << 30
_MAX_LABEL = np.iinfo(np.int32).max


def read_npz(path: Path, fps: float | None = None) -> Recording:
    """Read an ``.npz`` recording.

    `fps` are frames per second of tracks without times.

    Raises
    ------
    RecordingError
        If the file is truncated or empty, or lacks these arrays.
    OSError
        If it cannot be opened.
    """
    with _refused("it is not an .npz archive, or is damaged or truncated"), path.open("rb") as file:
        # Loading pickled arrays would execute code from the file.
        archive = np.load(file, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise RecordingError("it is not an .npz archive")
        return _recording(path.stem, archive, fps)


def read_npy(path: Path, fps: float | None = None) -> Recording:
    """Read the positions of a point tracker, one array; as :func:`read_npz`.

    Raises
    ------
    RecordingError
        If it is not such an array.
    OSError
        If it cannot be opened.
    """
    with _refused("it is not an array of numbers, or is damaged"):
        # A mapped array is not allocated: its header may announce more than the file holds.
        return tracks_recording(path.stem, {"tracks": np.load(path, mmap_mode="r", allow_pickle=False)}, fps)


@contextmanager
def _refused(what: str) -> Iterator[None]:
    """Raise what NumPy raises of damaged files as a RecordingError."""
    try:
        yield
    except (RecordingError, OSError):
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many types on damaged files
        raise RecordingError(f"{what} ({type(error).__name__})") from None


def _recording(name: str, archive: Any, fps: float | None) -> Recording:
    has_positions = "positions" in archive
    arrays = {
        key: _array(archive, key)
        for key in (("positions", "times") if has_positions else NAMES)
        if key in archive
    }
    recording = tracks_recording(name, arrays, fps)
    if not has_positions:
        return recording
    unit = str(_array(archive, "units")) if "units" in archive and recording.dim == 3 else "m"
    if unit not in METRES:
        raise RecordingError(f"its unit is {unit[:20]!r}, not one of {', '.join(METRES)}")
    recording.positions *= METRES[unit]
    recording.labels = _labels(archive, recording.positions.shape[1])
    if recording.labels is not None:
        recording.objects = _label_names(archive)
    return recording


def _array(archive: Any, name: str) -> NDArray[Any]:
    # NumPy allocates what a header announces, and the system what is then written.
    members = {info.filename: info.file_size for info in archive.zip.infolist()}
    if (size := max(members.get(f"{name}.npy", 0), members.get(name, 0))) > _MAX_BYTES:
        raise RecordingError(f"its member {name!r} unpacks to {size} bytes")
    try:
        array = archive[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise RecordingError(f"its array {name!r} holds Python objects, not numbers") from None
    if not isinstance(array, np.ndarray):  # NumPy returns other members of the archive as bytes
        raise RecordingError(f"its member {name!r} is not an array")
    return array


def _labels(archive: Any, markers: int) -> NDArray[np.int64] | None:
    if "labels" not in archive:
        return None
    labels = _array(archive, "labels")
    if labels.shape != (markers,) or labels.dtype.kind not in "iu":
        raise RecordingError(f"its labels are not {markers} integers")
    if labels.size and int(labels.max()) > _MAX_LABEL:
        raise RecordingError("a label exceeds 2147483647")
    # Outliers and joints have labels below 1.
    return np.where(labels >= 1, labels.astype(np.int64), AMBIGUOUS)


def _label_names(archive: Any) -> dict[int, str]:
    """Object number -> name; `segment_names` starts with object 1, `label_names` with object 0."""
    for key, first in (("segment_names", 1), ("label_names", 0)):
        names = _array(archive, key) if key in archive else np.empty(0)
        if names.ndim == 1 and names.dtype.kind == "U":
            return {first + k: text[:64] for k, text in enumerate(names.tolist()) if text}
    return {}
