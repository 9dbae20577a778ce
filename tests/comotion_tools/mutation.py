"""Changes of inputs by chance."""

import random
from collections.abc import Sequence

_NUMBERS = (
    b"0",
    b"-1",
    b"1e999",
    b"nan",
    b"99999999999999999999",
    b"\xff" * 8,
    b"\x00" * 8,
    b"\x7f" + b"\xff" * 7,
)
_MOST = 8


def mutated(chance: random.Random, inputs: Sequence[bytes]) -> bytes:
    """One of several inputs, with a few changes."""
    data = bytearray(chance.choice(inputs))
    for _ in range(chance.randint(1, _MOST)):
        _change(chance, data, inputs)
    return bytes(data)


def _change(chance: random.Random, data: bytearray, inputs: Sequence[bytes]) -> None:
    """Change a few bytes at some place."""
    at = chance.randrange(len(data) + 1)
    end = min(len(data), at + chance.randint(1, 16))
    match chance.randrange(6):
        case 0:
            data[at:end] = bytes(chance.randrange(256) for _ in range(end - at))
        case 1:
            del data[at:end]
        case 2:
            data[at:at] = data[at:end] * chance.choice((1, 2, 50))
        case 3:
            data[at:end] = chance.choice(_NUMBERS)
        case 4:
            other = chance.choice(inputs)
            start = chance.randrange(len(other) + 1)
            data[at:end] = other[start : start + 64]
        case 5 if data:
            data[at % len(data)] ^= 1 << chance.randrange(8)
