"""Objects are saved as plain values, and built again by their types."""

from collections import deque
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import pytest

from comotion.arrays import Floats
from comotion.saving import NOT_KEPT, plain, refill, restored


class Range(NamedTuple):
    low: float
    high: float


@dataclass
class Inner:
    points: Floats
    kind: Literal["a", "b"] = "a"
    turn: list[float] | float | None = None


@dataclass
class Outer:
    name: str = "one"
    others: dict[int, Inner] = field(default_factory=dict)
    ranges: tuple[Range, ...] = ()
    pair: tuple[int, Inner | None] = (0, None)
    seen: set[int] = field(default_factory=set)
    queue: deque[tuple[int, float]] = field(default_factory=deque)
    clock: object = field(default=None, metadata=NOT_KEPT)


def filled():
    inner = Inner(np.arange(6.0).reshape(2, 3), "b", [0.5])
    return Outer("two", {3: inner}, (Range(0, 1),), (4, Inner(np.zeros(0))), {7}, deque([(1, 2.0)]), object())


def same(one, other):
    assert plain(one).keys() == plain(other).keys()
    np.testing.assert_equal(plain(one), plain(other))


def test_what_is_saved_is_built_again():
    found = restored(Outer, plain(filled()))
    same(found, filled())
    assert isinstance(found.ranges[0], Range)
    assert isinstance(found.others[3], Inner)
    assert isinstance(found.queue, deque)
    assert found.seen == {7}
    assert found.clock is None


def test_an_object_is_filled_and_keeps_what_is_not_saved():
    one = Outer(clock="mine")
    refill(one, plain(filled()))
    same(one, filled())
    assert one.clock == "mine"


def test_what_is_saved_shares_nothing_with_the_object():
    one = filled()
    state = plain(one)
    one.others[3].points[:] = 9
    one.seen.add(8)
    np.testing.assert_equal(restored(Outer, state).others[3].points, np.arange(6.0).reshape(2, 3))
    assert restored(Outer, state).seen == {7}


def test_a_state_of_another_layout_is_an_error():
    with pytest.raises(KeyError):
        refill(Outer(), {"name": "two"})
    with pytest.raises(TypeError):
        restored(Inner, {"kind": "a"})
