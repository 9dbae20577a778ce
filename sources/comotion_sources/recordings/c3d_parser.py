"""Parses one C3D file in a separate process: ``c3d_parser.py FILE`` writes an .npz to standard output.

ezc3d is native code and crashes on some damaged files (measured: 5 of 146 files with a few changed
bytes in the parameters). It does not support the SGI encoding, for which the package c3d is used. Neither
reports missing data at the end of a file; the frame count in the header shows it.
"""

import io
import struct
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

# From the C3D specification: block size in bytes, key byte, processor types and their byte order, and
# the largest frame number that the header can hold.
_BLOCK = 512
_MAGIC = 0x50
_SGI = 86
_PROCESSORS = {84: "<", 85: "<", _SGI: ">"}
_SATURATED = 0xFFFF
_MEMORY = 4 << 30  # bytes; ten minutes of 300 markers at 200 Hz take about 1 GiB
# Model outputs in the list of points that are not positions.
_OTHER_QUANTITIES = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")


@dataclass(frozen=True)
class Header:
    """Processor type and expected number of frames (None: more than the header can hold)."""

    processor: int
    frames: int | None


@dataclass(frozen=True)
class Points:
    """Content of the file: positions [F, N, 3] in `unit`, residuals [F, N] (below 0: invalid)."""

    positions: NDArray[np.float64]
    residuals: NDArray[np.float64]
    rate: float
    unit: str
    labels: list[str]
    others: set[str]


def read_header(raw: bytes) -> Header:
    """Parse the header and the start of the parameter section.

    Raises
    ------
    InputError
        If this is not a C3D file.
    """
    if len(raw) < _BLOCK or raw[1] != _MAGIC:
        raise InputError("it is not a C3D file")
    processor_at = (raw[0] - 1) * _BLOCK + 3
    processor = raw[processor_at] if 0 <= processor_at < len(raw) else 0
    if processor not in _PROCESSORS:
        raise InputError("it is damaged or truncated: no parameter section")
    first, last = struct.unpack_from(_PROCESSORS[processor] + "HH", raw, 6)
    return Header(processor, None if last == _SATURATED else last - first + 1)


def parse(path: Path) -> dict[str, Any]:
    """Read positions (NaN where missing), rate and unit.

    Raises
    ------
    InputError
        If the file is not a C3D file, or is truncated.
    """
    with path.open("rb") as file:
        header = read_header(file.read(256 * _BLOCK))
    points = _with_c3d(path) if header.processor == _SGI else _with_ezc3d(path)
    frames = len(points.positions)
    if header.frames is not None and frames < header.frames:
        raise InputError(f"it is truncated: {frames} of {header.frames} frames")
    wanted = [label not in points.others for label in points.labels]
    # Exporters write a lost marker with a negative residual, as NaN, or exactly at the origin.
    lost = (points.residuals < 0) | np.all(points.positions == 0, axis=2)
    positions = np.where(lost[..., None], np.nan, points.positions)[:, wanted]
    return {"positions": positions, "rate": points.rate, "unit": points.unit}


def _with_ezc3d(path: Path) -> Points:
    import ezc3d

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of NumPy, about means of empty arrays
        content = ezc3d.c3d(str(path))
    point = content["parameters"]["POINT"]
    positions = np.moveaxis(content["data"]["points"][:3], 0, -1).swapaxes(0, 1)
    return Points(
        positions=positions,
        residuals=content["data"]["meta_points"]["residuals"][0].T,
        rate=float(point["RATE"]["value"][0]),
        unit=_first(point.get("UNITS", {}).get("value")),
        labels=_pad(list(point.get("LABELS", {}).get("value", [])), positions.shape[1]),
        others={label for name in _OTHER_QUANTITIES for label in point.get(name, {}).get("value", [])},
    )


def _with_c3d(path: Path) -> Points:
    import c3d

    with warnings.catch_warnings(), path.open("rb") as file:
        warnings.simplefilter("ignore")
        reader = c3d.Reader(file)
        frames = np.array([points for _, points, _ in reader.read_frames()], np.float64)
        units = reader.get("POINT:UNITS")
        others = [reader.get(f"POINT:{name}") for name in _OTHER_QUANTITIES]
        return Points(
            positions=frames[..., :3],
            residuals=frames[..., 3],
            rate=float(reader.point_rate),
            unit=_first([units.string_value] if units else None),
            labels=_pad([str(label) for label in reader.point_labels], frames.shape[1]),
            others={str(label) for group in others if group for label in group.string_array.ravel()},
        )


def _first(values: Any) -> str:
    return str(values[0]).strip() if values else ""


def _pad(labels: list[str], count: int) -> list[str]:
    return [label.strip() for label in labels[:count]] + [""] * (count - len(labels))


def _limit_memory() -> None:
    """Limit the memory: a damaged header may request any amount."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


def main(arguments: list[str]) -> int:
    """Write the arrays to standard output as .npz, or one line to standard error."""
    _limit_memory()
    try:
        arrays = parse(Path(arguments[0]))
    except Exception as error:  # the libraries raise many types on damaged files
        message = str(error) if isinstance(error, InputError) else f"it is damaged ({error})"
        sys.stderr.write(" ".join(message.split()) + "\n")
        return 1
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    sys.stdout.buffer.write(buffer.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
