"""Whatever bytes come from outside: the result is right, or one clear line; in bounded time and memory."""

import time
import tracemalloc
from itertools import islice

import msgpack
import numpy as np
import pytest

from comotion_schemas import DecodeError, decode, encode

from .mutation import mutated
from .targets import TARGETS, batch, corpus

_RUNS = {"core": 15, "urdf": 40, "state": 40}
_DEFAULT_RUNS = 150
# A merge bomb of 1 KB took 21 s of processor time.
_MOST_S = 10.0


@pytest.mark.parametrize("name", TARGETS)
def test_mutated_inputs_are_read_or_refused_in_one_line(name: str) -> None:
    if name == "urdf":
        pytest.importorskip("mujoco")
    if name == "mcap":
        pytest.importorskip("mcap")
    if name == "c3d":
        pytest.importorskip("c3d")
    target = TARGETS[name]
    for data in [*corpus(name), *islice(mutated(corpus(name), seed=1), _RUNS.get(name, _DEFAULT_RUNS))]:
        began = time.process_time()
        target.check(data)
        assert time.process_time() - began < _MOST_S


def _bombs() -> dict[str, bytes]:
    good = msgpack.unpackb(encode(batch()))
    return {
        "large": encode(batch(ids=np.arange(200_000, dtype=np.uint64), positions=np.zeros((200_000, 3)))),
        "many nils": msgpack.packb(good | {"colours": [0] * 99_000}),
        "nested": b"\x91" * 1_000_000,
        "announced": b"\x81\xa1a\xdd\xff\xff\xff\xff",
        "empty maps": b"\xdc\xff\xff" + b"\x80" * 65_535,
    }


@pytest.mark.parametrize("name", _bombs())
def test_decoding_takes_twice_the_message_and_a_constant(name: str) -> None:
    data = _bombs()[name]
    decode(encode(batch()))
    tracemalloc.start()
    try:
        decode(data)
    except DecodeError:
        pass
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 2 * len(data) + 20_000_000
