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
from typing import Any

import msgpack
import numpy as np

from comotion_schemas import encode
from comotion_schemas.component import Component
from comotion_schemas.transport import client_settings

from .attacks import NAME, WITHIN_LIMITS, Attacker, attack, repeat

_RATE = 50.0


def _mutated(attacker: Attacker) -> bytes:
    chance, data = attacker.chance, bytearray(encode(attacker.batch()))
    for _ in range(chance.randint(1, 8)):
        data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data[: chance.randint(1, len(data))])


def _noise(attacker: Attacker) -> bytes:
    return attacker.chance.randbytes(attacker.chance.choice((0, 10, 5000, 200_000)))


def _tampered(attacker: Attacker) -> bytes:
    changes = (
        {"positions": np.full(150, math.nan, "<f4").tobytes()},
        {"ids": np.zeros(50, "<u8").tobytes()},
        {"seq": -1},
        {"colour": "red"},
        {"dim": 7},
        {"stamp_ns": -(2**63)},
    )
    content = msgpack.unpackb(encode(attacker.batch())) | attacker.chance.choice(changes)
    return msgpack.packb(content)  # type: ignore[no-any-return]


def _extreme(attacker: Attacker) -> bytes:
    chance, now = attacker.chance, time.time_ns()
    count, other = chance.choice((50, 2000)), f"{chance.getrandbits(64):016x}"
    far = chance.choice((1e3, 1e6, 9e8)) * chance.choice((1, -1))
    millimetres = [[chance.uniform(-1000, 1000) for _ in range(3)] for _ in range(count)]
    changes: tuple[dict[str, Any], ...] = (
        {"seq": 2**63 - 1, "session": other},
        {"stamp_ns": -(2**63)},
        {"stamp_ns": 2**63 - 1},
        {"space": f"space-{chance.randrange(1000)}"},
        {"unit": "px"},
        {"session": other},
        {"positions": np.full((count, 3), far, np.float32)},
        {"positions": np.array(millimetres, np.float32)},
        {"stamp_ns": now, "stamps_ns": now - np.arange(count)[::-1] * 1000},
    )
    return encode(attacker.batch(count, **chance.choice(changes)))


_MAKERS = (_mutated, _noise, _tampered, _extreme, _extreme, _extreme, _extreme)


def damage(attacker: Attacker) -> None:
    """Publish a batch that is damaged or extreme."""
    maker = attacker.chance.choice(_MAKERS)
    attacker.session.put(attacker.keys.stream("obs", NAME), maker(attacker))
    attacker.seq += 1


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
            repeat(damage, _RATE, attacker, seconds / 2)
            chosen, seconds = [chance.choice(WITHIN_LIMITS)], seconds / 2
        attack(chosen[0], attacker, seconds)
        print(json.dumps({"session": attacker.run, "sent": attacker.seq}), flush=True)


if __name__ == "__main__":
    main()
