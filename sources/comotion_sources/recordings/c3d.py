"""Reads C3D recordings: Intel, DEC and SGI, integer and real (extra ``mocap``)."""

import importlib.util
import io
import subprocess
import sys
from pathlib import Path

import numpy as np

from comotion_schemas.time_units import LONGEST_STEP_S

from ..errors import RecordingError
from .npz import METRES
from .recording import Recording, clean

_TIMEOUT_S = 120.0  # a damaged file may keep the native library busy without end


def read_c3d(path: Path) -> Recording:
    """Read a C3D recording.

    Lengths are converted to metres; a file without a unit is in mm, the convention of the format.
    Markers with a negative residual, with NaN or exactly at the origin are unobserved.

    Raises
    ------
    RecordingError
        If the file is truncated, empty or not a C3D file, or the extra ``mocap`` is not installed.
    """
    for library in ("ezc3d", "c3d"):
        if importlib.util.find_spec(library) is None:
            raise RecordingError(f"reading C3D needs {library}: pip install 'comotion[mocap]'")
    with np.load(io.BytesIO(_parse(path)), allow_pickle=False) as content:
        positions, rate, unit = content["positions"], float(content["rate"]), str(content["unit"])
    if not 1 / LONGEST_STEP_S <= rate < np.inf:
        raise RecordingError(f"its frame rate is {rate:g} Hz")
    scale = METRES.get(unit.lower() or "mm")
    if scale is None:
        raise RecordingError(f"its unit is {unit[:20]!r}, not one of {', '.join(METRES)}")
    return Recording(
        name=path.stem,
        times=np.arange(len(positions)) / rate,
        positions=clean(positions * scale),
        labels=None,
        label_names={},
    )


def _parse(path: Path) -> bytes:
    # Run by its path with -P: the module search path then does not contain this folder, and `import c3d`
    # finds the library.
    command = [sys.executable, "-P", str(Path(__file__).with_name("c3d_parser.py")), str(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_TIMEOUT_S, check=False)  # noqa: S603
    except subprocess.TimeoutExpired:
        raise RecordingError(f"it is damaged: not read after {_TIMEOUT_S:g} s") from None
    if done.returncode == 0:
        return done.stdout
    if done.returncode < 0:
        raise RecordingError("it is damaged: the C3D library crashed on it")
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    raise RecordingError(lines[-1] if lines else "it could not be read")
