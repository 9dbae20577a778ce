"""Reads what point trackers (CoTracker, TAPIR, TAP-Vid and the like) say of their tracks: arrays, and tables.

Arrays have the names that the trackers give them: positions ``tracks``, ``pred_tracks``, ``points``,
``trajs_2d`` or ``tracks_XYZ``, [T, N, 2 or 3] or [N, T, 2 or 3]; whether a point is seen ``visibility``,
``pred_visibility``, ``visibles``, ``visibs``, or ``occluded``, ``occlusion``, a truth value, probability or
log odds; ``confidence`` or ``expected_dist``; ``sigma``; ``times`` or ``fps``. An axis of one batch is left
out. Positions with two coordinates are in pixels, those with three in metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import KnownError, RecordingError
from comotion_schemas.time_units import seconds

from ..bounded import read_cells
from . import Recording, clean

POSITIONS = ("positions", "tracks", "pred_tracks", "points", "trajs_2d", "tracks_XYZ")
SEEN = ("visibility", "pred_visibility", "visibilities", "visibles", "visible", "visibs")
HIDDEN = ("occluded", "occlusion", "occlusions")
CONFIDENCE, UNCERTAIN = ("confidence", "confidences", "pred_confidence"), ("expected_dist",)
SIGMA, TIMES, RATE = ("sigma",), ("times", "timestamps"), ("fps",)
# Names by which the first axis is known: TAPIR and TAP-Vid have points first, CoTracker and ours frames.
_POINTS_FIRST = ("points", "visibles", *HIDDEN, *UNCERTAIN, "query_points")
_FRAMES_FIRST = ("pred_tracks", "pred_visibility")
NAMES = {*POSITIONS, *SEEN, *HIDDEN, *CONFIDENCE, *UNCERTAIN, *SIGMA, *TIMES, *RATE, "query_points"}
"""All arrays that are read."""

# Share of the picture's longer side beyond which trackers call a position wrong when they learn their
# confidence: CoTracker 12 px of 512, TAPIR 6 px of 256.
_WRONG = 0.0234
# px; least noise of a position: trackers are smooth over time, so that differences do not show all of it.
_LEAST_SIGMA_PX = 0.1
# Sum of the squared coefficients of a third difference, and the median of a chi-squared variable with two
# degrees of freedom.
_THIRD, _CHI2_MEDIAN = 20.0, 1.386

Arrays = Mapping[str, NDArray[Any]]
# Names of a column: the first that is there of each.
_ID = ("track", "track_id", "feature", "feature_id", "point", "point_id", "particle", "id")
_FRAME, _TIME = ("frame", "frame_id"), ("time", "times", "t", "timestamp")
# Cells of frames and tracks; a gigabyte of positions.
_MOST_CELLS = 1 << 26
_WORDS = {"": "nan", "true": "1", "false": "0"}


def tracks_recording(name: str, arrays: Arrays, fps: float | None) -> Recording:
    """Build a recording of the arrays of a point tracker.

    A position that is more likely wrong than right is unobserved: its probability to be seen times its
    confidence is at most one half. In pixels, the noise of the others follows from their confidence.

    `arrays` are by their names, see above; `fps` are frames per second, for arrays without times.

    Raises
    ------
    RecordingError
        If there are no positions or no times, or shapes do not fit.
    """
    array = _first(arrays, POSITIONS)
    if array is None:
        raise RecordingError(f"it has no array {', '.join(map(repr, POSITIONS[:-1]))} or {POSITIONS[-1]!r}")
    place = _points(array)
    finite = place[np.isfinite(place)]
    if (
        place.shape[2] == 2
        and "positions" not in arrays
        and finite.size
        and 0 <= finite.min() <= finite.max() <= 1
    ):
        raise RecordingError("its positions lie within 0 to 1: multiply them by width and height in px")
    probability = _per_point(arrays, SEEN, place) * (1 - _per_point(arrays, HIDDEN, place, missing=0.0))
    confidence = _per_point(arrays, CONFIDENCE, place) * (
        1 - _per_point(arrays, UNCERTAIN, place, missing=0.0)
    )
    sigma = _first(arrays, SIGMA)
    if _points_first(arrays, place, probability > 0.5):
        place, probability, confidence = place.swapaxes(0, 1), probability.T, confidence.T
        sigma = sigma.T if sigma is not None and sigma.ndim == 2 else sigma
    times = _times(arrays, len(place), fps)
    place = clean(np.where((probability * confidence > 0.5)[..., None], place, np.nan))
    rated = any(key in arrays for key in (*CONFIDENCE, *UNCERTAIN))
    noise = None if sigma is None else _given_noise(sigma, place)
    if noise is None and rated and place.shape[2] == 2:
        noise = _noise(place, confidence)
    return Recording(name=name, times=times - times[0], positions=place, sigma=noise)


def _first(arrays: Arrays, names: Sequence[str]) -> NDArray[np.float64] | None:
    """The first array of these names, without an axis of one batch."""
    array = next((arrays[name] for name in names if name in arrays), None)
    if array is None:
        return None
    if array.dtype.kind not in "biuf":
        raise RecordingError(f"its array {next(n for n in names if n in arrays)!r} has no numbers")
    return np.asarray(array, np.float64)


def _points(array: NDArray[np.float64]) -> NDArray[np.float64]:
    if array.ndim == 4 and len(array) == 1:
        array = array[0]
    if array.ndim != 3 or array.shape[2] not in {2, 3}:
        raise RecordingError(f"its positions have the shape {array.shape}, not (T, N, 2) or (N, T, 2)")
    if not array.size:
        raise RecordingError("it holds no observation")
    return array


def _per_point(
    arrays: Arrays, names: Sequence[str], place: NDArray[np.float64], missing: float = 1.0
) -> NDArray[np.float64]:
    """An array as probabilities of each position; `missing` where there is none."""
    value, shape = _first(arrays, names), place.shape[:2]
    if value is None:
        return np.full(shape, missing)
    if value.size != shape[0] * shape[1] or tuple(n for n in value.shape if n > 1) != tuple(
        n for n in shape if n > 1
    ):
        key = next(name for name in names if name in arrays)
        raise RecordingError(f"its array {key!r} has the shape {value.shape}, its positions {place.shape}")
    value = np.nan_to_num(value.reshape(shape), nan=missing, posinf=np.inf, neginf=-np.inf)
    if value.min() < 0 or value.max() > 1:
        value = 1 / (1 + np.exp(-np.clip(value, -50, 50)))
    return np.asarray(value)


def _points_first(arrays: Arrays, place: NDArray[np.float64], seen: NDArray[np.bool_]) -> bool:
    """Whether the first axis is that of points: by the number of times, by names, else by the steps."""
    if "positions" in arrays:
        return False
    times = next((len(arrays[name]) for name in TIMES if name in arrays and arrays[name].ndim == 1), None)
    if times is not None and place.shape[0] != place.shape[1]:
        return times != len(place)
    if any(name in arrays for name in _FRAMES_FIRST):
        return False
    if any(name in arrays for name in _POINTS_FIRST):
        return True
    visible = np.where(seen[..., None], place, np.nan)
    down, across = (_typical_step(visible, axis) for axis in (0, 1))
    return across < down


def _typical_step(place: NDArray[np.float64], axis: int) -> float:
    step = np.linalg.norm(np.diff(place, axis=axis), axis=2)
    step = step[np.isfinite(step)]
    return float(np.median(step)) if step.size else np.inf


def _times(arrays: Arrays, frames: int, fps: float | None) -> NDArray[np.float64]:
    given = next((arrays[name] for name in TIMES if name in arrays), None)
    if given is not None:
        if given.shape != (frames,):
            raise RecordingError(f"it has {' x '.join(map(str, given.shape))} times for {frames} frames")
        try:
            return seconds(given)
        except KnownError as error:
            raise RecordingError(str(error)) from None
    rate = _first(arrays, RATE)
    if rate is not None and rate.size == 1:
        fps = float(rate.reshape(-1)[0])
    if fps is None:
        raise RecordingError("it has no times: --fps says how many frames per second it has")
    if not 0 < fps < np.inf:
        raise RecordingError(f"{fps:g} frames per second are not above 0")
    return np.arange(frames) / fps


def _given_noise(sigma: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        noise = np.broadcast_to(sigma, place.shape[:2]).copy()
    except ValueError:
        raise RecordingError(f"its sigma has the shape {sigma.shape}, its positions {place.shape}") from None
    if not (noise[np.isfinite(place[..., 0])] > 0).all():
        raise RecordingError("its sigma is not above 0 everywhere")
    return noise


def _noise(place: NDArray[np.float64], confidence: NDArray[np.float64]) -> NDArray[np.float64]:
    """One-sigma noise of every position, px [T, N], by the confidence in it.

    A right position has the noise of its track, a wrong one is off by what trackers call wrong; the variance
    is the mean of both, weighted with the confidence.
    """
    square = (np.diff(place, n=3, axis=0) ** 2).sum(axis=2) / _THIRD
    enough = np.isfinite(square).any(axis=0) if len(square) else np.zeros(place.shape[1], np.bool_)
    right = np.full(place.shape[1], _LEAST_SIGMA_PX**2)
    if enough.any():
        of_track = np.nanmedian(square[:, enough], axis=0) / _CHI2_MEDIAN
        right[enough] = np.maximum(of_track, right[enough])
        right[~enough] = np.median(right[enough])
    seen = place[np.isfinite(place[..., 0])]
    wrong = _WRONG * float(np.ptp(seen, axis=0).max()) if len(seen) else 0.0
    return np.asarray(np.sqrt(confidence * right + (1 - confidence) * wrong**2 / 2))


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

    def grid(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of rows as an array [T, N, ...], NaN where there is no row."""
        array = np.full((len(stamps) * len(ids), *values.shape[1:]), np.nan)
        array[cells] = values
        return array.reshape(len(stamps), len(ids), *values.shape[1:])

    optional = [name for name in (*SEEN, *HIDDEN, *CONFIDENCE, *UNCERTAIN, *SIGMA) if name in columns]
    arrays = {name: grid(columns[name]) for name in optional}
    arrays["pred_tracks"] = grid(np.stack([columns[name] for name in "xyz" if name in columns], axis=1))
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
    columns = dict(zip(map(str.lower, header), table.T, strict=True))
    if "hypothesis" in columns:
        # Of comotion segment: its confidence is that of the hypothesis.
        columns = {name: column for name, column in columns.items() if name not in CONFIDENCE}
    if not {"x", "y"} <= columns.keys():
        raise RecordingError("it has no columns x and y; its first line names the columns")
    return columns


def _check(ids: NDArray[np.float64], stamps: NDArray[np.float64]) -> None:
    """Refuse ids that are none, and more than fits into memory."""
    if np.isnan(ids).any() or np.isnan(stamps).any():
        raise RecordingError("a row has neither frame nor track")
    if (ids < 0).any() or (ids != np.floor(ids)).any() or (ids > 2**53).any():
        raise RecordingError("its tracks are not whole numbers from 0 to 2**53")
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
