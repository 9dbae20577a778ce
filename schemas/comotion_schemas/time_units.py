"""Converts times as people have them to seconds, or raises one error that guesses what they are.

A unit is certain, and converted, where the type says it (datetime64, timedelta64, pandas, datetime), where
the numbers are Unix times of this century, and where whole numbers step in one unit as a sensor does and in
no other. Numbers with a fraction that step too widely for seconds are an error: they may be anything.
"""

import datetime
import warnings
from contextlib import suppress
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import KnownError

TimeUnit = Literal["s", "ms", "us", "ns"]
PER_SECOND: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
LONGEST_STEP_S = 2.0
"""Median time between two instants that a trajectory of some 10 s can be made of."""
_WORDS: dict[TimeUnit, str] = {
    "s": "seconds",
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
}
# 2001 to 2096: seconds have 10 digits.
_UNIX_S = (1e9, 4e9)
# No sensor of features is faster; a sensor of more than 2 kHz is no reason to take a step for its period.
_SHORTEST_STEP_S, _SENSOR_STEP_S = 1e-5, 5e-4
_DAY_S = 86_400.0
# Unix times in seconds may be that slow, and are then refused as such.
_SLOW_S = 300.0
_LONGEST_GAP_S = 1 * _DAY_S
# So many times that go up by one are more likely numbers of frames.
_MANY = 4


def seconds(times: ArrayLike, *, longest_step_s: float = LONGEST_STEP_S) -> NDArray[np.float64]:
    """Times of the instants of a recording, in seconds.

    Parameters
    ----------
    times
        [T], increasing: numbers in s, or in ms, us or ns where that is certain (see the module), from any
        origin; or datetime64, timedelta64, datetime, or a column of pandas of these (then: Unix time).
    longest_step_s
        Median time between two instants, s, above which they are not taken for seconds.

    Returns
    -------
    float64 [T], s, finite, increasing, without a gap of more than a day.

    Raises
    ------
    ValueError
        If they are not such times; the message says what they look like.
    """
    values, typed = _numbers(times)
    _check_order(values)
    if not typed and len(values) > 1:
        values = values / PER_SECOND[_unit(values, np.asarray(times).dtype.kind in "iu", longest_step_s)]
    if len(values) > 1:
        _check_steps(np.diff(values), longest_step_s, values)
    if not typed and len(values) >= _MANY and bool((np.diff(values) == 1).all()):
        warnings.warn(
            "times go up by exactly one and are taken for seconds; if they are frame numbers, divide them by "
            "the frame rate",
            stacklevel=5,  # the caller of comotion.group
        )
    return values


def instant(time: object) -> float:
    """One time in seconds, converted as in :func:`seconds` where its type or the Unix time tells its unit.

    Raises
    ------
    ValueError
        If it is not one finite time, or no time in seconds.
    """
    if time is None or np.ndim(time) != 0:  # type: ignore[arg-type]
        raise KnownError(f"the time is {_short(time)}, not a number of seconds")
    values, typed = _numbers([time])
    value = float(values[0])
    if not np.isfinite(value):
        raise KnownError(f"the time {value} is not finite")
    unit = None if typed else unix_unit(value)
    if unit is None and not typed and abs(value) > _UNIX_S[1]:
        raise KnownError(
            f"the time {value:.6g} is no time in seconds; nanoseconds since a start? Divide by 1e9"
        )
    return value / PER_SECOND[unit or "s"]


def unix_unit(value: float) -> TimeUnit | None:
    """The unit in which a number is a Unix time of this century; None: in none."""
    units = (unit for unit, scale in PER_SECOND.items() if _UNIX_S[0] <= value / scale < _UNIX_S[1])
    return next(units, None)


def _numbers(times: object) -> tuple[NDArray[np.float64], bool]:
    """As float64 [T], and whether their type says that they are seconds now."""
    array: NDArray[Any] = np.asarray(())
    with suppress(TypeError, ValueError, OverflowError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy converts a datetime with a zone to UTC, as it should
        array = np.array(times)
        if array.dtype.kind == "O" and array.size:
            kind = "m8[us]" if isinstance(array.flat[0], datetime.timedelta) else "M8[us]"
            array[array != array] = None  # noqa: PLR0124 - pandas.NaT
            array = array.astype(kind)
        if array.dtype.kind in "mM":
            nanoseconds = array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64)
            return np.where(np.isnat(array), np.nan, nanoseconds / 1e9), True
        if array.dtype.kind in "iuf":
            return array.astype(np.float64), False
    raise KnownError(f"times are {_short(times)}, not numbers")


def _check_order(values: NDArray[np.float64]) -> None:
    if values.ndim != 1:
        raise KnownError(f"times have the shape {values.shape}, not [T]")
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        raise KnownError(f"time number {wrong[0]} is not finite ({wrong.size} of {len(values)} are not)")
    back = np.flatnonzero(np.diff(values) <= 0)
    if back.size:
        k = int(back[0])
        word = "repeats" if values[k + 1] == values[k] else "comes after"
        raise KnownError(
            f"times do not increase: number {k + 1} ({values[k + 1]:.9g}) {word} {values[k]:.9g}; "
            f"{back.size} of {len(values)} do so; sort them, and merge equal ones"
        )


def _unit(values: NDArray[np.float64], whole: bool, longest_step_s: float) -> TimeUnit:
    """The unit of increasing numbers, as far as it is certain; else s, or an error that guesses."""
    unix, step = unix_unit(float(np.median(values))), float(np.median(np.diff(values)))
    # Nanoseconds since a start look like a Unix time in another unit, but for their steps.
    if unix is not None and step / PER_SECOND[unix] <= (_SLOW_S if unix == "s" else longest_step_s):
        return unix
    if step <= longest_step_s:
        return "s"
    fitting: list[TimeUnit] = [
        unit for unit, scale in PER_SECOND.items() if _SENSOR_STEP_S <= step / scale <= longest_step_s
    ]
    if whole and len(fitting) == 1:
        return fitting[0]
    guess = " or ".join(
        f"{_WORDS[unit]} ({PER_SECOND[unit] / step:.3g} Hz): divide by {PER_SECOND[unit]:g}"
        for unit in fitting
    )
    raise KnownError(
        f"times step by {step:.6g}; in seconds that is too slow to see motion. "
        + (f"They look like {guess}" if guess else "Give them in seconds")
    )


def _check_steps(steps: NDArray[np.float64], longest_step_s: float, values: NDArray[np.float64]) -> None:
    """Steps in seconds are those of a sensor, and none is a jump of the clock."""
    step, widest = float(np.median(steps)), int(np.argmax(steps))
    if step > longest_step_s:
        raise KnownError(
            f"one instant in {step:.6g} s is too seldom to see motion; at most {longest_step_s:g} s (a fifth "
            "of `window`) may be between two. Are they in another unit?"
        )
    if step < _SHORTEST_STEP_S:
        raise KnownError(f"times step by {step:.3g} s, {1 / step:.3g} Hz; give them in seconds")
    if steps[widest] > _LONGEST_GAP_S:
        raise KnownError(
            f"after number {widest} ({values[widest]:.9g} s) times jump by {steps[widest] / _DAY_S:.3g} "
            "days; drop times that were not set, or group the parts one by one"
        )


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
