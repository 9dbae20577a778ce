"""A process that does what no source should: damaged bytes, lies, extremes, and attacks within the limits.

``python -m comotion_tools.soak.hostile ENDPOINT SCENE SECONDS SEED`` draws by the seed from both, half of
the time each; with the name of one of :mod:`.attacks` behind, it does that alone. It says how many messages
it has sent, as JSON. That it could also use the name of another source is a matter of access control.
"""

import json
import math
import random
import sys
import time
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np

from comotion_schemas import encode
from comotion_schemas.component import Component
from comotion_schemas.transport import client_settings

from .attacks import NAME, WITHIN_LIMITS, Attacker, attack, resting_batch

_RATE = 50.0


def _mutated(chance: random.Random, payload: bytes) -> bytes:
    data = bytearray(payload)
    for _ in range(chance.randint(1, 8)):
        data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data[: chance.randint(1, len(data))])


def _jump(chance: random.Random, session: str, seq: int) -> bytes:
    far = np.full((50, 3), chance.choice((1e3, 1e6, 9e8)), np.float32) * chance.choice((1, -1))
    return encode(resting_batch(session, seq, positions=far))


def _millimetres(chance: random.Random, session: str, seq: int) -> bytes:
    rows = np.array([[chance.uniform(-1000, 1000) for _ in range(3)] for _ in range(50)], np.float32)
    return encode(resting_batch(session, seq, positions=rows))


def _tampered(chance: random.Random, session: str, seq: int) -> bytes:
    content = msgpack.unpackb(encode(resting_batch(session, seq)))
    change = chance.choice(
        [
            {"positions": np.full(150, math.nan, "<f4").tobytes()},
            {"ids": np.zeros(50, "<u8").tobytes()},
            {"seq": -1},
            {"colour": "red"},
            {"dim": 7},
            {"stamp_ns": -(2**63)},
        ]
    )
    return msgpack.packb(content | change)  # type: ignore[no-any-return]


def _extreme(chance: random.Random, session: str, seq: int) -> bytes:
    change: dict[str, Any] = chance.choice(
        [
            {"seq": 2**63 - 1, "session": f"{chance.getrandbits(64):016x}"},
            {"stamp_ns": -(2**63)},
            {"stamp_ns": 2**63 - 1},
            {"space": f"space-{chance.randrange(1000)}"},
            {"unit": "px"},
            {"session": f"{chance.getrandbits(64):016x}"},
        ]
    )
    return encode(resting_batch(session, seq, **change))


def _many_instants(chance: random.Random, session: str, seq: int) -> bytes:
    count = chance.choice((100, 2000))
    now = time.time_ns()
    return encode(
        resting_batch(session, seq, count, stamp_ns=now, stamps_ns=now - np.arange(count)[::-1] * 1000)
    )


_MAKERS: tuple[Callable[[random.Random, str, int], bytes], ...] = (
    lambda chance, session, seq: _mutated(chance, encode(resting_batch(session, seq))),
    lambda chance, _session, _seq: chance.randbytes(chance.choice((0, 10, 5000, 200_000))),
    _jump,
    _millimetres,
    _tampered,
    _extreme,
    _many_instants,
)


def damage(attacker: Attacker, seconds: float) -> None:
    """Publish batches that are damaged or extreme."""
    end, key = time.monotonic() + seconds, attacker.keys.stream("obs", NAME)
    while time.monotonic() < end:
        maker = attacker.chance.choice(_MAKERS)
        attacker.session.put(key, maker(attacker.chance, attacker.run, attacker.seq))
        attacker.seq += 1
        time.sleep(1 / _RATE)


def main() -> None:
    """Attack for some seconds."""
    endpoint, scene, duration, seed, *chosen = sys.argv[1:]
    chance, seconds = random.Random(seed), float(duration)
    settings = client_settings([endpoint])
    # A token that is held twice neither comes nor goes.
    holds = "tokens" not in chosen
    with Component(role="source", name=NAME, scene=scene, settings=settings, has_token=holds) as component:
        attacker = Attacker(component.session, component.keys, chance, component.session_id)
        print(json.dumps({"session": attacker.run, "sent": 0}), flush=True)
        if not chosen:
            damage(attacker, seconds / 2)
            chosen, seconds = [chance.choice(WITHIN_LIMITS)], seconds / 2
        attack(chosen[0], attacker, seconds)
        print(json.dumps({"session": attacker.run, "sent": attacker.seq}), flush=True)


if __name__ == "__main__":
    main()
