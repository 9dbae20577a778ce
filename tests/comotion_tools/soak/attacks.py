"""What one source within every limit of a message can do to a scene: by name, what it does and how often.

Each attack is a function of an :class:`Attacker`, called at a rate for as long as the attack lasts. The soak
draws from them by its seed, or does one alone, as the tests in ``tests/adversary`` do.
"""

import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import msgpack
import numpy as np
import zenoh

from comotion_schemas import Keys, ObservationBatch, Status, encode
from comotion_schemas.component import new_session_id

from .load import BODIES, ID_STEP, Kind, places, positions

NAME = "hostile"
VICTIM = "left"
"""The source in whose name it lies."""
MARKUP = "[/nope] [bold]\x1b[2J\x1b]0;owned\x07\x9b31m\r\nok: all is well\u202e.\u2066 " + 60 * "x"
"""What ends a table of rich, clears a terminal, forges a line and turns what follows."""
_TOP = 2**64 - 1
_DRIFTER = Kind(30, 24)
# rad/s, and s after which it begins.
_DRIFT, _STEADY_S = 0.02, 5.0


@dataclass
class Attacker:
    """An open session at the scene, and what an attack has done so far."""

    session: zenoh.Session
    keys: Keys
    chance: random.Random
    run: str = field(default_factory=new_session_id)
    seq: int = 0
    held: list[Any] = field(default_factory=list)

    def batch(self, count: int = 50, /, **changes: Any) -> ObservationBatch:
        """The next batch: `count` features at rest, with changes of its fields."""
        fields: dict[str, Any] = {
            "source": NAME,
            "session": self.run,
            "seq": self.seq,
            "space": "world",
            "unit": "m",
            "dim": 3,
            "stamp_ns": time.time_ns(),
            "ids": np.arange(count, dtype=np.uint64),
            "positions": np.zeros((count, 3), np.float32),
        }
        return ObservationBatch(**(fields | changes))

    def send(self, message: ObservationBatch | Status, **forged: Any) -> None:
        """Publish a message, with fields that no message of ours can have."""
        if isinstance(message, Status):
            key = self.keys.stream("status", NAME)
        else:
            key = self.keys.stream("obs", message.source)
        content = encode(message)
        self.session.put(key, msgpack.packb(msgpack.unpackb(content) | forged) if forged else content)
        self.seq += 1

    def status(self, **changes: Any) -> Status:
        """A Status of its own, with changes."""
        fields: dict[str, Any] = {key: {} for key in ("rates", "ages", "counters", "rejected")}
        fields |= {"component": NAME, "role": "source", "session": self.run}
        fields |= {"stamp_ns": time.time_ns(), "state": "ok", "message": ""}
        return Status(**(fields | changes))


def instants(attacker: Attacker) -> None:
    """1000 instants in a batch of 30 kB."""
    now, rows = time.time_ns(), 1000
    stamps = now - np.arange(rows)[::-1] * 30_000
    ids = np.arange(rows, dtype=np.uint64) % 10
    attacker.send(attacker.batch(rows, stamp_ns=now, stamps_ns=stamps, ids=ids))


def spaces(attacker: Attacker) -> None:
    """2000 features in 100 spaces, one space a batch."""
    space = attacker.seq % 100
    ids = np.arange(20 * space, 20 * space + 20, dtype=np.uint64)
    rows = np.random.default_rng(attacker.seq).normal(0, 1, (20, 3)).astype(np.float32)
    attacker.send(attacker.batch(20, space=f"space-{space}", ids=ids, positions=rows))


def new_spaces(attacker: Attacker) -> None:
    """Another space in every batch."""
    attacker.send(attacker.batch(5, space=f"space-{attacker.seq}"))


def names(attacker: Attacker) -> None:
    """Another name in every batch."""
    attacker.send(attacker.batch(5, source=f"{NAME}-{attacker.seq}", seq=0))


def claim(attacker: Attacker) -> None:
    """An empty batch that says that the space of the others is one of pixels."""
    nothing: dict[str, Any] = {"ids": np.zeros(0, np.uint64), "positions": np.zeros((0, 2), np.float32)}
    attacker.send(attacker.batch(0, unit="px", dim=2, **nothing))


def carry(attacker: Attacker) -> None:
    """Features that say that the frame of the space of the others is carried."""
    rows = np.random.default_rng(1).normal(0, 1, (100, 3)).astype(np.float32)
    attacker.send(attacker.batch(100, moving=True, positions=rows))


def lie(attacker: Attacker) -> None:
    """A Status on its own key that says how much another source has sent."""
    counters = {"sent": 2**31 - 1, "batches": 2**31 - 1}
    attacker.send(attacker.status(component=VICTIM, session=new_session_id(), counters=counters))


def markup(attacker: Attacker) -> None:
    """Texts that a terminal or a table would obey."""
    texts = {"message": MARKUP, "host": MARKUP, "version": MARKUP, "rates": {MARKUP: 1.0}}
    attacker.send(attacker.status(), **texts)
    attacker.send(attacker.batch(5), space=MARKUP if attacker.seq % 4 == 1 else "[/nope]")


def statuses(attacker: Attacker) -> None:
    """A Status of 2 kB."""
    attacker.send(attacker.status(message=2000 * "x", counters={"sent": attacker.seq}))


def drift(attacker: Attacker) -> None:
    """It sees the bodies of the others, twice as many features of each, and turns away."""
    seen = positions(_DRIFTER, places(_DRIFTER, 1), time.time())
    seen += np.random.default_rng(attacker.seq).normal(0, 0.002, seen.shape)
    angle = _DRIFT * max(attacker.seq / _DRIFTER.rate - _STEADY_S, 0.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    ids = ID_STEP * np.arange(BODIES)[:, None] + np.arange(_DRIFTER.features)
    rows = (seen.reshape(-1, 3) @ turn.T).astype(np.float32)
    attacker.send(attacker.batch(len(rows), ids=ids.reshape(-1).astype(np.uint64), positions=rows))


def large(attacker: Attacker) -> None:
    """A valid batch of 3.9 MB."""
    rows = 195_000
    attacker.send(attacker.batch(rows, positions=np.zeros((rows, 3), np.float32)))


def tokens(attacker: Attacker) -> None:
    """Its own liveliness token comes and goes."""
    liveliness = attacker.session.liveliness()
    for _ in range(100):
        liveliness.declare_token(attacker.keys.live("source", NAME)).undeclare()  # type: ignore[no-untyped-call]
    attacker.seq += 100


def many_tokens(attacker: Attacker) -> None:
    """Tokens of ever more sources."""
    liveliness = attacker.session.liveliness()
    for _ in range(100):
        key = attacker.keys.live("source", f"{NAME}-{attacker.seq}")
        attacker.held.append(liveliness.declare_token(key))
        attacker.seq += 1


def seize(attacker: Attacker) -> None:
    """The token of a service that claims to be older than all."""
    if not attacker.held:
        key = attacker.keys.live("service", f"x-{1:016x}-{attacker.run}")
        attacker.held.append(attacker.session.liveliness().declare_token(key))
        attacker.seq += 1


def outrank(attacker: Attacker) -> None:
    """One update of the highest epoch there is."""
    if attacker.seq:
        return
    from comotion import Fusion  # slow to import, and the others do without

    update = Fusion(scene=attacker.keys.scene, session=attacker.run).update(time.time_ns())
    update = replace(update, epoch=_TOP, live=True, published_ns=time.time_ns())
    attacker.session.put(attacker.keys.hypotheses, encode(update))
    attacker.seq += 1


ATTACKS: dict[str, tuple[Callable[[Attacker], None], float]] = {
    "instants": (instants, 30),
    "many-instants": (instants, 120),
    "spaces": (spaces, 240),
    "new-spaces": (new_spaces, 400),
    "names": (names, 1500),
    "claim": (claim, 0.5),
    "carry": (carry, 30),
    "lie": (lie, 1),
    "markup": (markup, 2),
    "statuses": (statuses, 3000),
    "large": (large, 10),
    "drift": (drift, _DRIFTER.rate),
    "tokens": (tokens, 400),
    "many-tokens": (many_tokens, 200),
    "seize": (seize, 1),
    "outrank": (outrank, 1),
}
"""What each does, and how often a second."""
# What needs no more than an ordinary certificate, each kind once: access control denies the others.
WITHIN_LIMITS = tuple(name for name in ATTACKS if name not in ("many-instants", "seize", "outrank"))


def attack(name: str, attacker: Attacker, seconds: float) -> int:
    """Run an attack for some seconds; returns how much it has done."""
    repeat(*ATTACKS[name], attacker, seconds)
    return attacker.seq


def repeat(step: Callable[[Attacker], None], rate: float, attacker: Attacker, seconds: float) -> None:
    """Do something so often a second, for some seconds."""
    began, done = time.monotonic(), 0
    while (elapsed := time.monotonic() - began) < seconds:
        while done <= elapsed * rate and time.monotonic() - began < seconds:
            step(attacker)
            done += 1
        time.sleep(min(1 / rate, 0.002))
