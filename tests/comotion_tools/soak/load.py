"""A source of the soak, as a process: three bodies, and an account of what it has sent.

``python -m comotion_tools.soak.load ENDPOINT SCENE NAME`` reads one command a line from standard input, as
JSON, and prints its account a few times a second, as JSON. The body of a feature is its id over 1000, so
that the soak knows the truth. All sources of a space agree on where a body is at a time.
"""

import json
import random
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import client_settings, stream_publisher

BODIES = 3
ID_STEP = 1000
_NOISE_M = 0.002
_NOISE_PX = 0.3
_ACCOUNT_S = 0.2


@dataclass(frozen=True)
class Kind:
    """What a source is: batches a second, features of each body, and its space."""

    rate: float
    features: int
    space: str = "world"
    unit: str = "m"
    dim: int = 3


KINDS = {
    "left": Kind(15, 12),
    "right": Kind(30, 12),
    "arm": Kind(100, 4),
    "camera": Kind(15, 15, "camera/pixels", "px", 2),
}


def places(kind: Kind, seed: int) -> NDArray[np.float64]:
    """Features of the bodies in their own axes, float64 [BODIES, features, dim], in the space's unit."""
    scale = 0.15 if kind.unit == "m" else 60.0
    return np.random.default_rng(seed).uniform(-scale, scale, (BODIES, kind.features, kind.dim))


def positions(kind: Kind, features: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Where they are at a time in s: the first body rests, the others swing, each in its own way."""
    scale = 1.0 if kind.unit == "m" else 200.0
    found = features.copy()
    found[:, :, 0] += scale * np.arange(BODIES)[:, None]
    for body in range(1, BODIES):
        swing = 0.3 * scale * np.sin(2 * np.pi * (0.11 + 0.06 * body) * t + body)
        found[body, :, body % 2] += swing
    return found


@dataclass
class Account:
    """What has been sent: `sent` counts sequence numbers, `repeated` those that were sent again."""

    sent: int = 0
    repeated: int = 0
    paused: bool = False
    late: deque[bytes] = field(default_factory=deque)

    def declared(self, session: str) -> str:
        """As a line of JSON."""
        found = {"session": session, "sent": self.sent, "repeated": self.repeated, "paused": self.paused}
        return json.dumps(found)


@dataclass
class _Faults:
    """What is wrong at the moment; each until a time on the monotonic clock."""

    clock_s: float = 0.0
    clock_until: float = 0.0
    loss_until: float = 0.0
    disorder_until: float = 0.0
    generation: int = 0
    burst: int = 0
    paused: bool = False


@dataclass
class Source:
    """Makes the batches of one source."""

    name: str
    session: str
    seed: int
    faults: _Faults = field(default_factory=_Faults)
    seq: int = 0

    def __post_init__(self) -> None:
        self.kind = KINDS[self.name]
        self._features = places(self.kind, self.seed)
        self._rng = np.random.default_rng(self.seed)

    def batch(self) -> ObservationBatch:
        """The next batch, as of now."""
        kind, faults = self.kind, self.faults
        now = time.time()
        offset = faults.clock_s if time.monotonic() < faults.clock_until else 0.0
        found = positions(kind, self._features, now)
        found += self._rng.normal(0, _NOISE_M if kind.unit == "m" else _NOISE_PX, found.shape)
        ids = ID_STEP * np.arange(BODIES)[:, None] + np.arange(kind.features) + 100 * faults.generation
        self.seq += 1
        return ObservationBatch(
            source=self.name,
            session=self.session,
            seq=self.seq - 1,
            space=kind.space,
            unit=kind.unit,  # type: ignore[arg-type]
            dim=kind.dim,
            stamp_ns=round((now + offset) * 1e9),
            ids=ids.reshape(-1).astype(np.uint64),
            positions=found.reshape(-1, kind.dim).astype(np.float32),
        )


def _obey(faults: _Faults, command: dict[str, Any]) -> None:
    until = time.monotonic() + command.get("lasts_s", 0.0)
    match command["do"]:
        case "clock":
            faults.clock_s, faults.clock_until = command["size"], until
        case "loss":
            faults.loss_until = until
        case "disorder":
            faults.disorder_until = until
        case "churn":
            # Within the hundreds that leave the thousands, which name the body, alone.
            faults.generation = (faults.generation + 1) % 9
        case "burst":
            faults.burst = int(command["size"])
        case "pause" | "resume":
            faults.paused = command["do"] == "pause"


def _listen(faults: _Faults) -> None:
    for line in sys.stdin:
        _obey(faults, json.loads(line))


def _send(source: Source, publisher: Any, account: Account, chance: random.Random) -> None:
    """Send what is due, as the faults of the moment say."""
    faults, now = source.faults, time.monotonic()
    held: deque[bytes] = deque()
    for _ in range(1 + faults.burst):
        payload = encode(source.batch())
        account.sent += 1
        if now < faults.loss_until and chance.random() < 0.2:
            continue
        held.append(payload)
        if now < faults.disorder_until and chance.random() < 0.2:
            held.append(payload)
            account.repeated += 1
    faults.burst = 0
    account.late.extend(held)
    in_order = now >= faults.disorder_until
    while len(account.late) > (0 if in_order else 2):
        first = account.late.popleft()
        if not in_order:
            publisher.put(account.late.popleft())
        publisher.put(first)


def main() -> None:
    """Publish until stopped."""
    endpoint, scene, name = sys.argv[1:4]
    settings = client_settings([endpoint])
    chance = random.Random(name)
    with Component(role="source", name=name, scene=scene, settings=settings) as component:
        source = Source(name, component.session_id, seed=sum(name.encode()))
        publisher = stream_publisher(component.session, component.keys, "obs", name)
        threading.Thread(target=_listen, args=(source.faults,), daemon=True).start()
        account = Account()
        due = said = time.monotonic()
        while not component.stop.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            # What was missed while this process was stopped is not made up for.
            due = max(due + 1 / source.kind.rate, now)
            if not source.faults.paused:
                _send(source, publisher, account, chance)
            while source.faults.paused and account.late:
                publisher.put(account.late.popleft())
            if now - said > _ACCOUNT_S:
                said, account.paused = now, source.faults.paused
                print(account.declared(source.session), flush=True)


if __name__ == "__main__":
    main()
