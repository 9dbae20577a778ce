"""Times are converted where their unit is certain, and refused with a guess where it is not."""

import datetime
import re

import numpy as np
import pytest

from comotion_schemas.errors import Error
from comotion_schemas.time_units import instant, seconds

T = np.arange(60) / 30
NS = (T * 1e9).astype(np.int64)
START = np.datetime64("2024-01-01")
UNIX = 1_704_067_200


@pytest.mark.parametrize(
    ("times", "origin"),
    [
        (T, 0),
        (UNIX + T, UNIX),
        (UNIX * 10**9 + NS, UNIX),
        (NS // 1000, 0),
        (NS.astype(np.uint64) + np.uint64(8 * 10**14), 8e5),
        (NS + 2 * 10**12, 2000),
        (START + NS.astype("timedelta64[ns]"), UNIX),
        (NS.astype("timedelta64[ns]"), 0),
        ([datetime.datetime(2024, 1, 1) + datetime.timedelta(seconds=t) for t in T.tolist()], UNIX),
    ],
)
def test_a_certain_unit_is_converted(times, origin):
    np.testing.assert_allclose(seconds(times) - origin, T, atol=2e-6)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (T * 1e3, "look like milliseconds (30 Hz): divide by 1000"),
        (UNIX + 5 * np.arange(60), "one instant in 5 s is too seldom"),
        (T * 1e9 + 2e9, "look like nanoseconds (30 Hz)"),
        (T * 3e4, "milliseconds (1 Hz): divide by 1000 or microseconds (1e+03 Hz)"),
        (T[::-1], "times do not increase: number 1 (1.93333333) comes after 1.96666667; 59 of 60"),
        (np.where(T > 1, np.nan, T), "time number 31 is not finite (29 of 60 are not)"),
        (np.r_[0.0, UNIX + T], "after number 0 (0 s) times jump by 1.97e+04 days"),
        (np.array(["NaT", "2024-01-01"], "datetime64[s]"), "time number 0 is not finite"),
        (["a", "b"], "not numbers"),
        (T[None], "times have the shape (1, 60), not [T]"),
    ],
)
def test_any_other_is_one_error_that_guesses(times, words):
    with pytest.raises(Error, match=re.escape(words)):
        seconds(times)


def test_numbers_of_frames_are_doubted():
    with pytest.warns(UserWarning, match="divide them by the frame rate"):
        seconds(np.arange(60))


@pytest.mark.parametrize(
    "time", [UNIX, UNIX * 1000, np.int64(UNIX) * 10**9, START, datetime.datetime(2024, 1, 1)]
)
def test_one_instant_is_converted(time):
    assert instant(time) == UNIX


@pytest.mark.parametrize("time", [None, "now", float("nan"), [1.0], 8.6e14])
def test_what_is_no_instant_is_an_error(time):
    with pytest.raises(Error):
        instant(time)
