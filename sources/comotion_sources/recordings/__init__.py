"""Reads recordings of features, for replay and offline evaluation."""

import logging
from pathlib import Path

from comotion_schemas.doubts import doubts
from comotion_schemas.errors import InputError, RecordingError
from comotion_schemas.recording import SUFFIX

from .recording import Recording, recording_streams

__all__ = ["Recording", "RecordingError", "read_recording", "recording_streams"]

_log = logging.getLogger(__name__)


def read_recording(path: str | Path, fps: float | None = None) -> Recording:
    """Read a recording, by its suffix: ``.c3d``, ``.npz``, ``.npy`` or ``.csv``.

    Parameters
    ----------
    path
        The file.
    fps
        Frames per second of tracks whose file has no times.

    Raises
    ------
    RecordingError
        If the file is missing, truncated, empty or not a recording; one line that names the file.
    """
    from .c3d import read_c3d
    from .npz import read_npy, read_npz
    from .tracks import read_csv

    path = Path(path)
    readers = {".c3d": read_c3d, ".npz": read_npz, ".npy": read_npy, ".csv": read_csv}
    reader = readers.get(path.suffix.lower())
    try:
        if path.stat().st_size == 0:
            raise RecordingError("the file is empty")
        if reader is None:
            # A recorded scene has readers of its own; it is accepted wherever these are.
            raise RecordingError(f"its ending is not one of {', '.join((*readers, SUFFIX))}")
        recording = reader(path, fps)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}") from None
    except InputError as error:
        raise RecordingError(f"{path}: {error}") from None
    for text in doubts(recording.positions, recording.unit):
        _log.warning("%s: %s", path, text)
    return recording
