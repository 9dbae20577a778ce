"""Reads C3D recordings: Intel, DEC and SGI, integer and real, by the package c3d (extra ``mocap``)."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from comotion_schemas.errors import RecordingError
from comotion_schemas.time_units import LONGEST_STEP_S

from . import Recording, clean
from .npz import METRES

# From the specification: block size in bytes, key byte, and the largest frame number in a header.
_BLOCK = 512
_MAGIC = 0x50
_SATURATED = 0xFFFF
# Ten minutes of 300 markers at 200 Hz take 0.6 GB.
_MAX_BYTES = 1 << 30
# Writers fill texts with either.
_PADDING = " \0"
# Model outputs in the list of points that are not positions.
_OTHER_QUANTITIES = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")


def read_c3d(path: Path, fps: float | None = None) -> Recording:  # noqa: ARG001
    """Read a C3D recording, which has a frame rate of its own.

    Lengths are converted to metres; a file without a unit is in mm, the convention of the format.
    Markers with a negative residual, with NaN or exactly at the origin are unobserved.

    Raises
    ------
    RecordingError
        If the file is truncated, empty or not a C3D file, or the extra ``mocap`` is not installed.
    OSError
        If it cannot be opened.
    """
    try:
        import c3d
    except ModuleNotFoundError:
        raise RecordingError("reading C3D needs c3d: pip install 'comotion[mocap]'") from None
    if path.stat().st_size > _MAX_BYTES:
        raise RecordingError(f"it has more than {_MAX_BYTES} bytes")
    raw = path.read_bytes()
    if len(raw) < _BLOCK or raw[1] != _MAGIC:
        raise RecordingError("it is not a C3D file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of parameters that few programs read
            # From memory: a read of what a damaged header announces then allocates no more than there is.
            return _recording(path.stem, c3d.Reader(io.BytesIO(raw)))
    except RecordingError:
        raise
    except Exception as error:  # the library raises many types on damaged files
        raise RecordingError(f"it is damaged or truncated ({' '.join(str(error).split())})") from None


def _recording(name: str, reader: Any) -> Recording:
    rate, unit = float(reader.point_rate), reader.get("POINT:UNITS")
    if not 1 / LONGEST_STEP_S <= rate < np.inf:
        raise RecordingError(f"its frame rate is {rate:g} Hz")
    unit = unit.string_value.strip(_PADDING) if unit else ""
    scale = METRES.get(unit.lower() or "mm")
    if scale is None:
        raise RecordingError(f"its unit is {unit[:20]!r}, not one of {', '.join(METRES)}")
    points = _points(reader)
    # Exporters write a lost marker with a negative residual, as NaN, or exactly at the origin.
    lost = (points[..., 3] < 0) | np.all(points[..., :3] == 0, axis=2)
    positions = np.where(lost[..., None], np.nan, points[..., :3])[:, _are_positions(reader)]
    return Recording(
        name=name,
        times=np.arange(len(positions)) / rate,
        positions=clean(positions * scale),
    )


def _points(reader: Any) -> np.ndarray:
    """Positions in the unit of the file and residuals, float64 [F, N, 4]."""
    if not reader.point_used:  # its frames would take no bytes, and never end
        raise RecordingError("it holds no markers")
    # Analog channels are left out; those of more than 255 would be an error.
    reader.get_analog_transform = lambda: (1.0, 0.0)
    frames = [points[:, :4] for _, points, _ in reader.read_frames(analog_transform=False)]
    announced = reader.header.last_frame - reader.header.first_frame + 1
    if reader.header.last_frame != _SATURATED and len(frames) < announced:
        raise RecordingError(f"it is truncated: {len(frames)} of {announced} frames")
    return np.array(frames, np.float64)


def _are_positions(reader: Any) -> np.ndarray:
    """Which of the points are positions, bool [N]."""
    groups = [reader.get(f"POINT:{name}") for name in _OTHER_QUANTITIES]
    others = {str(label).strip(_PADDING) for group in groups if group for label in group.string_array.ravel()}
    labels = [str(label).strip(_PADDING) for label in reader.point_labels[: reader.point_used]]
    return np.array([label not in others for label in labels] + [True] * (reader.point_used - len(labels)))
