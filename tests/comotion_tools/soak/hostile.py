"""A process that does what no source should: damaged bytes, lies, extremes, and attacks within the limits.

``python -m comotion_tools.soak.hostile ENDPOINT SCENE SECONDS SEED ATTACK`` does one of :mod:`.attacks`, or,
where the name is that of the kind, draws by the seed from both, half of the time each. It says how many
messages it has sent, as JSON. That it could use the name of another source is a matter of access control.
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

from ..mutation import mutated
from .attacks import NAME, WITHIN_LIMITS, Attacker, attack, repeat

_RATE = 50.0


def _extreme(attacker: Attacker) -> bytes:
    """A batch with a value that no source should send."""
    chance, now = attacker.chance, time.time_ns()
    count, other = chance.choice((50, 2000)), f"{chance.getrandbits(64):016x}"
    far = chance.choice((1e3, 1e6, 9e8, math.nan)) * chance.choice((1, -1))
    changes: tuple[dict[str, Any], ...] = (
        {"seq": 2**63 - 1, "session": other},
        {"seq": -1},
        {"stamp_ns": -(2**63)},
        {"stamp_ns": 2**63 - 1},
        {"space": f"space-{chance.randrange(1000)}"},
        {"unit": "px"},
        {"dim": 7},
        {"colour": "red"},
        {"session": other},
        {"ids": np.zeros(count, "<u8").tobytes()},
        {"positions": np.full((count, 3), far, "<f4").tobytes()},
        {"stamp_ns": now, "stamps_ns": (now - np.arange(count)[::-1] * 1000).astype("<i8").tobytes()},
    )
    content = msgpack.unpackb(encode(attacker.batch(count))) | chance.choice(changes)
    return msgpack.packb(content)  # type: ignore[no-any-return]


def damage(attacker: Attacker) -> None:
    """Publish a batch that is extreme, or damaged bytes of one."""
    payload, noise = _extreme(attacker), attacker.chance.randbytes(5000)
    if attacker.chance.random() < 0.4:
        payload = mutated(attacker.chance, [payload, noise])
    attacker.session.put(attacker.keys.stream("obs", NAME), payload)
    attacker.seq += 1


def main() -> None:
    """Attack for some seconds."""
    endpoint, scene, duration, seed, chosen = sys.argv[1:]
    chance, seconds = random.Random(seed), float(duration)
    settings = client_settings([endpoint])
    # A token that is held twice neither comes nor goes.
    holds = chosen != "tokens"
    with Component(role="source", name=NAME, scene=scene, settings=settings, has_token=holds) as component:
        attacker = Attacker(component.session, component.keys, chance, component.session_id)
        print(json.dumps({"session": attacker.run, "sent": 0}), flush=True)
        if chosen == NAME:
            repeat(damage, _RATE, attacker, seconds / 2)
            chosen, seconds = chance.choice(WITHIN_LIMITS), seconds / 2
        attack(chosen, attacker, seconds)
        print(json.dumps({"session": attacker.run, "sent": attacker.seq}), flush=True)


if __name__ == "__main__":
    main()
