"""Reads tables of point trackers (CSV), with a row per point and frame."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bounded import read_cells
from ..errors import RecordingError
from .recording import Recording
from .tracks import CONFIDENCE, HIDDEN, SEEN, SIGMA, UNCERTAIN, tracks_recording

# Names of a column: the first that is there of each.
_ID = ("track", "track_id", "feature", "feature_id", "point", "point_id", "particle", "id")
_FRAME, _TIME = ("frame", "frame_id"), ("time", "times", "t", "timestamp")
# Cells of frames and tracks; a gigabyte of positions.
_MOST_CELLS = 1 << 26
_WORDS = {"": "nan", "true": "1", "false": "0"}


def read_csv(path: Path, fps: float | None = None) -> Recording:
    """Read a table with a row per point and frame, and the names of its columns in the first line.

    Columns: ``frame`` or ``time`` (s), or both; ``track`` (or ``feature``, ``point``, ``particle``, ``id``);
    ``x``, ``y`` and in space ``z``, empty where not seen; and as arrays have them, visibility, confidence and
    ``sigma``. Others are left out. A table of ``comotion segment`` is one, too.

    Raises
    ------
    RecordingError
        If it lacks a column, or a cell is no number.
    OSError
        If it cannot be opened.
    """
    columns = _read(path)
    track = _column(columns, _ID, "track")
    instant = _column(columns, (*_FRAME, *_TIME), "frame")
    ids, column = np.unique(track, return_inverse=True)
    stamps, row = np.unique(instant, return_inverse=True)
    _check(ids, stamps)
    cells = row * len(ids) + column
    if len(np.unique(cells)) < len(cells):
        raise RecordingError("a frame has a track twice")
    place = np.stack([columns[name] for name in "xyz" if name in columns], axis=1)
    arrays = {"pred_tracks": _grid(cells, place, len(stamps), len(ids))}
    for name in (*SEEN, *HIDDEN, *CONFIDENCE, *UNCERTAIN, *SIGMA):
        if name in columns:
            arrays[name] = _grid(cells, columns[name], len(stamps), len(ids))
    times = next((columns[name] for name in _TIME if name in columns), None)
    if times is not None:
        arrays["times"] = np.zeros(len(stamps))
        arrays["times"][row] = times
    elif fps is not None:
        arrays["times"] = stamps / fps  # frames without a row are a gap
    return replace(tracks_recording(path.stem, arrays, fps), ids=ids.astype(np.uint64))


def _read(path: Path) -> dict[str, NDArray[np.float64]]:
    """The columns by name."""
    lines = read_cells(path)
    _, header = next(lines, (0, []))
    table = np.array([[_number(cell, line) for cell in cells] for line, cells in lines]).reshape(
        -1, len(header)
    )
    columns = dict(zip(header, table.T, strict=True))
    if "hypothesis" in columns:
        # Of comotion segment: its confidence is that of the hypothesis.
        columns = {name: column for name, column in columns.items() if name not in CONFIDENCE}
    if not {"x", "y"} <= columns.keys():
        raise RecordingError("it has no columns x and y")
    return columns


def _check(ids: NDArray[np.float64], stamps: NDArray[np.float64]) -> None:
    """Refuse ids that are none, and more than fits into memory."""
    if np.isnan(ids).any() or np.isnan(stamps).any():
        raise RecordingError("a row has neither frame nor track")
    if (ids < 0).any() or (ids != np.floor(ids)).any():
        raise RecordingError("its tracks are not whole numbers from 0 on")
    if len(ids) * len(stamps) > _MOST_CELLS:
        raise RecordingError(f"{len(stamps)} frames with {len(ids)} tracks are too many for one recording")


def _number(cell: str, line: int) -> float:
    try:
        return float(_WORDS.get(cell.lower(), cell))
    except ValueError:
        raise RecordingError(f"line {line}: {cell[:20]!r} is not a number") from None


def _column(columns: Mapping[str, NDArray[np.float64]], names: Sequence[str], what: str) -> NDArray[Any]:
    column = next((columns[name] for name in names if name in columns), None)
    if column is None:
        raise RecordingError(f"it has no column {what!r}; its first line names the columns")
    return column


def _grid(cells: NDArray[np.intp], values: NDArray[np.float64], frames: int, tracks: int) -> NDArray[Any]:
    """Values of rows as an array [T, N, ...], NaN where there is no row."""
    grid = np.full((frames * tracks, *values.shape[1:]), np.nan)
    grid[cells] = values
    return grid.reshape(frames, tracks, *values.shape[1:])
