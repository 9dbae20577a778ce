"""Objects as plain values and back by their types, these as bytes and back; what is none is a clear error."""

import hashlib
import struct
from collections import deque
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import msgpack
import numpy as np
import pytest

from comotion import saving
from comotion.arrays import Floats
from comotion.saving import NOT_KEPT, load, pieces, plain, restored


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


def test_what_is_saved_is_built_again():
    again = restored(Outer, plain(filled()))
    np.testing.assert_equal(plain(again), plain(filled()))
    assert isinstance(again.ranges[0], Range)
    assert isinstance(again.others[3], Inner)
    assert isinstance(again.queue, deque)
    assert again.seen == {7}
    assert again.clock is None


def dump(state):
    return b"".join(pieces(state))


def test_arrays_come_back_with_shape_and_dtype_and_can_be_written_to():
    arrays = {"empty": np.zeros((0, 3)), "matrix": np.arange(6, dtype=np.int32).reshape(2, 3)}
    loaded = load(dump({"arrays": arrays, "scalar": np.int64(7)}), dict)
    assert loaded["scalar"] == 7
    for name, array in arrays.items():
        assert np.array_equal(loaded["arrays"][name], array)
        assert loaded["arrays"][name].dtype == array.dtype
    loaded["arrays"]["matrix"][0, 0] = 9


def signed(values: bytes, version: int = saving.FORMAT) -> bytes:
    """A snapshot whose checksums are right, whatever is in it."""
    digest = hashlib.blake2b(values, digest_size=16).digest()
    return struct.pack("<8sIQ16s", b"comotion", version, len(values), digest) + values


GOOD = dump({"rows": np.arange(9), "plain": "text"})


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a snapshot"),
        (b"holiday pictures", "not a snapshot"),
        (GOOD[:20], "ends within its header"),
        (GOOD[:-1], "checksum is wrong"),
        (GOOD + b"x", "checksum is wrong"),
        (signed(b"\xc1"), "damaged"),
        (signed(msgpack.packb({"a": {"__array__": ["<f8", [1 << 60], 0]}})), "damaged"),
        (signed(b"\x91" * 5000), "damaged"),
        (signed(b"", 3), f"format 3, expected {saving.FORMAT}"),
    ],
)
def test_what_is_no_snapshot_is_a_clear_error(data, words):
    with pytest.raises(ValueError, match=words):
        load(data, lambda state: state["a"])


def test_every_changed_byte_is_found():
    for k in range(len(GOOD)):
        damaged = GOOD[:k] + bytes([GOOD[k] ^ 1]) + GOOD[k + 1 :]
        with pytest.raises(ValueError, match="snapshot"):
            load(damaged, dict)
