"""Plain values and arrays to bytes and back; what is no snapshot is a clear error."""

import hashlib

import msgpack
import numpy as np
import pytest

from comotion import snapshot
from comotion.snapshot import HEADER_BYTES, Header, load, pieces


def dump(state, following=0):
    return b"".join(pieces(state, following))


def same(state):
    return state


def test_values_and_arrays_come_back_with_shape_and_dtype_and_can_be_written_to():
    state = {
        "plain": [1, 2.5, "three", None, True],
        "nested": {"empty": np.zeros((0, 3)), "matrix": np.arange(6, dtype=np.int32).reshape(2, 3)},
        "scalar": np.int64(7),
    }
    found = load(dump(state), same)
    assert (found["plain"], found["scalar"]) == (state["plain"], 7)
    for name, array in state["nested"].items():
        assert np.array_equal(found["nested"][name], array)
        assert found["nested"][name].dtype == array.dtype
    found["nested"]["matrix"][0, 0] = 9


def signed(values: bytes, arrays: bytes = b"") -> bytes:
    """A snapshot whose checksums are right, whatever is in it."""
    digest = hashlib.blake2b(values + arrays, digest_size=16).digest()
    return Header(len(values), len(arrays), 7, digest).pack() + values + arrays


GOOD = dump({"rows": np.arange(9), "plain": "text"}, following=7)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a snapshot"),
        (b"holiday pictures", "not a snapshot"),
        (GOOD[:20], "ends within its header"),
        (GOOD[:-1], "bytes, its header says"),
        (GOOD + b"x", "bytes, its header says"),
        (signed(b"\xc1"), "damaged"),
        (signed(msgpack.packb({"a": {"__array__": ["<f8", [1 << 60], 0]}})), "damaged"),
        (signed(b"\x91" * 5000), "damaged"),
    ],
)
def test_what_is_no_snapshot_is_a_clear_error(data, words):
    with pytest.raises(ValueError, match=words):
        load(data, lambda state: state["a"])


def test_every_changed_byte_is_found_and_the_next_id_outlives_all_damage_behind_the_header():
    for k in range(len(GOOD)):
        damaged = GOOD[:k] + bytes([GOOD[k] ^ 1]) + GOOD[k + 1 :]
        with pytest.raises(ValueError, match="snapshot"):
            load(damaged, same)
        if k >= HEADER_BYTES:
            assert Header.read(damaged).following == 7


def test_another_version_is_said(monkeypatch):
    monkeypatch.setattr(snapshot, "FORMAT", 3)
    older = dump({})
    monkeypatch.undo()
    with pytest.raises(ValueError, match=f"format 3, expected {snapshot.FORMAT}"):
        load(older, same)


@pytest.mark.parametrize("build", [lambda s: s["missing"], lambda s: s["a"][5], lambda s: s["a"].b, int])
def test_a_state_that_does_not_fit_is_damaged(build):
    data = dump({"a": [1]})
    with pytest.raises(ValueError, match="damaged snapshot"):
        load(data, build)
