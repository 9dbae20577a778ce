"""Plain values and arrays to bytes and back; what is no snapshot is a clear error."""

import msgpack
import numpy as np
import pytest

from comotion.snapshot import FORMAT, dump, load


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


def test_only_numeric_arrays_are_stored():
    with pytest.raises(TypeError, match="cannot store"):
        dump({"objects": np.array([object()])})
    hidden = msgpack.packb({"format": FORMAT, "a": {"__array__": ["|O", [1], b"12345678"]}})
    with pytest.raises(ValueError, match="not a snapshot"):
        load(hidden, same)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a snapshot"),
        (msgpack.packb([1]), "not a map"),
        (msgpack.packb({"format": "comotion.Snapshot/1"}), "format 'comotion.Snapshot/1', expected"),
        (dump({"rows": np.arange(9)})[:-1], "not a snapshot"),
    ],
)
def test_what_is_no_snapshot_is_a_clear_error(data, words):
    with pytest.raises(ValueError, match=words):
        load(data, same)


@pytest.mark.parametrize("build", [lambda s: s["missing"], lambda s: s["a"][5], lambda s: s["a"].b, int])
def test_a_state_that_does_not_fit_is_damaged(build):
    data = dump({"a": [1]})
    with pytest.raises(ValueError, match="damaged snapshot"):
        load(data, build)
