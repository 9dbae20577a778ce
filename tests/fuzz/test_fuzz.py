"""Whatever bytes come from outside: the result is right, or one clear line; in bounded time and memory.

``COMOTION_FUZZ_S=60`` mutates for so many seconds of processor time each, by another seed each time. What
fails is kept in the corpus, where it is replayed from then on.
"""

import hashlib
import os
import random
import time
import tracemalloc
from itertools import chain, count, islice, takewhile

import msgpack
import numpy as np
import pytest

from comotion_schemas import DecodeError, decode, encode
from comotion_tools.mutation import mutated

from .targets import CORPUS, TARGETS, batch, corpus

_RUNS = {"core": 15, "urdf": 40, "state": 40}
_DEFAULT_RUNS = 150
_SECONDS = float(os.environ.get("COMOTION_FUZZ_S", "0"))
# A merge bomb of 1 KB took 21 s of processor time.
_MOST_S = 10.0


def require(name):
    """Skip where the extra that reads the inputs is not installed."""
    if extra := {"urdf": "mujoco", "mcap": "mcap", "c3d": "c3d"}.get(name):
        pytest.importorskip(extra)


def inputs(name):
    """Those of the corpus and mutations of them."""
    valid, chance = corpus(name), random.Random(time.time_ns() if _SECONDS else 1)
    changed = (mutated(chance, valid) for _ in count())
    if not _SECONDS:
        return chain(valid, islice(changed, _RUNS.get(name, _DEFAULT_RUNS)))
    end = time.process_time() + _SECONDS
    return takewhile(lambda _: time.process_time() < end, changed)


@pytest.mark.timeout(120 + 4 * _SECONDS)
@pytest.mark.parametrize("name", TARGETS)
def test_mutated_inputs_are_read_or_refused_in_one_line(name):
    require(name)
    for data in inputs(name):
        began = time.process_time()
        try:
            TARGETS[name].check(data)
            assert time.process_time() - began < _MOST_S
        except Exception:
            (CORPUS / name).mkdir(exist_ok=True)
            (CORPUS / name / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
            raise


@pytest.mark.filterwarnings("ignore:positions span")
@pytest.mark.parametrize("file", sorted(CORPUS.glob("*/valid*")), ids=lambda file: "-".join(file.parts[-2:]))
def test_valid_files_to_begin_with_are_read(file):
    require(file.parent.name)
    TARGETS[file.parent.name].run(file.read_bytes())


def _bombs():
    good = msgpack.unpackb(encode(batch()))
    return {
        "large": encode(batch(ids=np.arange(200_000, dtype=np.uint64), positions=np.zeros((200_000, 3)))),
        "many nils": msgpack.packb(good | {"colours": [0] * 99_000}),
        "nested": b"\x91" * 1_000_000,
        "announced": b"\x81\xa1a\xdd\xff\xff\xff\xff",
        "empty maps": b"\xdc\xff\xff" + b"\x80" * 65_535,
    }


@pytest.mark.parametrize("name", _bombs())
def test_decoding_takes_twice_the_message_and_a_constant(name):
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
