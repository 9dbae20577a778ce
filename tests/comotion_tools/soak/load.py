"""A source of some bodies, as a process or in a thread, and an account of what it has sent.

:func:`command` starts one that reads one command a line from standard input, as JSON, and prints its account
a few times a second, as JSON. The body of a feature is its id over 1000, so that the soak knows the truth.
All sources of a space agree on where a body is at a time.
"""

import json
import random
import sys
import threading
import time
from collections import deque
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_deploy.processes import PYTHON
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
    """What a source is: batches a second, features of each body, its space, how far its clock is ahead."""

    rate: float
    features: int
    space: str = "world"
    unit: str = "m"
    dim: int = 3
    bodies: int = BODIES
    ahead_s: float = 0.0


KINDS = {
    "left": Kind(15, 12),
    "right": Kind(30, 12),
    "arm": Kind(100, 4),
    "camera": Kind(15, 15, "camera/pixels", "px", 2),
}


def command(endpoint: str, scene: str, name: str, what: Kind | int | None = None) -> tuple[str, ...]:
    """Words that start a source: of a kind, or one of the soak's, by its name, with so many features."""
    kind = what if isinstance(what, Kind) else KINDS[name]
    kind = replace(kind, features=what) if isinstance(what, int) else kind
    return (*PYTHON, __spec__.name, endpoint, scene, name, json.dumps(asdict(kind)))


def places(kind: Kind, seed: int) -> NDArray[np.float64]:
    """Features of the bodies in their own axes, float64 [bodies, features, dim], in the space's unit."""
    scale = 0.15 if kind.unit == "m" else 60.0
    return np.random.default_rng(seed).uniform(-scale, scale, (kind.bodies, kind.features, kind.dim))


def positions(kind: Kind, features: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Where they are at a time in s: the first body rests, the others swing, each in its own way."""
    scale = 1.0 if kind.unit == "m" else 200.0
    rows = features.copy()
    rows[:, :, 0] += scale * np.arange(kind.bodies)[:, None]
    for body in range(1, kind.bodies):
        swing = 0.3 * scale * np.sin(2 * np.pi * (0.11 + 0.06 * body) * t + body)
        rows[body, :, body % 2] += swing
    return rows


@dataclass
class _Faults:
    """What is wrong; some until a time on the monotonic clock."""

    until: dict[str, float] = field(default_factory=dict)  # of "clock", "loss" and "disorder"
    clock_s: float = 0.0
    generation: int = 0
    burst: int = 0
    paused: bool = False

    def obey(self, command: dict[str, Any]) -> None:
        """Let something be wrong from now on."""
        do, size = command["do"], command.get("size", 0.0)
        self.until[do] = time.monotonic() + command.get("lasts_s", 0.0)
        self.clock_s = size if do == "clock" else self.clock_s
        self.burst = int(size) if do == "burst" else self.burst
        # Within the hundreds that leave the thousands, which name the body, alone.
        self.generation = (self.generation + (do == "churn")) % 9
        self.paused = do == "pause" if do in {"pause", "resume"} else self.paused

    def now(self, what: str) -> bool:
        """Whether something is wrong at the moment."""
        return time.monotonic() < self.until.get(what, 0.0)


class Source:
    """Makes the batches of one source, and sends them as the faults of the moment say.

    `sent` are sequence numbers used, `repeated` batches sent again.
    """

    def __init__(self, component: Component, kind: Kind) -> None:
        self.name, self.session = component.name, component.session_id
        self.kind, self.faults = kind, _Faults()
        self.sent = self.repeated = 0
        seed = sum(self.name.encode())
        self._features = places(self.kind, seed)
        self._rng, self._chance = np.random.default_rng(seed), random.Random(self.name)
        self._publisher = stream_publisher(component.session, component.keys, "obs", self.name)
        self._late: deque[bytes] = deque()

    def batch(self) -> ObservationBatch:
        """The next batch, as of now."""
        kind, faults = self.kind, self.faults
        now = time.time_ns() * 1e-9
        offset = faults.clock_s if faults.now("clock") else 0.0
        rows = positions(kind, self._features, now)
        rows += self._rng.normal(0, _NOISE_M if kind.unit == "m" else _NOISE_PX, rows.shape)
        ids = ID_STEP * np.arange(kind.bodies)[:, None] + np.arange(kind.features) + 100 * faults.generation
        self.sent += 1
        return ObservationBatch(
            source=self.name,
            session=self.session,
            seq=self.sent - 1,
            space=kind.space,
            unit=kind.unit,  # type: ignore[arg-type]
            dim=kind.dim,
            stamp_ns=round((now + offset) * 1e9),
            ids=ids.reshape(-1).astype(np.uint64),
            positions=rows.reshape(-1, kind.dim).astype(np.float32),
        )

    def send(self) -> None:
        """Send what is due."""
        faults = self.faults
        for _ in range(1 + faults.burst):
            payload = encode(self.batch())
            if faults.now("loss") and self._chance.random() < 0.2:
                continue
            self._late.append(payload)
            if faults.now("disorder") and self._chance.random() < 0.2:
                self._late.append(payload)
                self.repeated += 1
        faults.burst = 0
        in_order = not faults.now("disorder")
        while len(self._late) > (0 if in_order else 2):
            first = self._late.popleft()
            if not in_order:
                self._publisher.put(self._late.popleft())
            self._publisher.put(first)

    def flush(self) -> None:
        """Send what it has held back to send it out of order."""
        while self._late:
            self._publisher.put(self._late.popleft())

    def account(self) -> str:
        """What it has sent, as a line of JSON."""
        counts = {"sent": self.sent, "repeated": self.repeated, "paused": self.faults.paused}
        return json.dumps({"session": self.session} | counts)

    def listen(self) -> None:
        """Obey the commands on standard input."""
        for line in sys.stdin:
            self.faults.obey(json.loads(line))


def main() -> None:
    """Publish until stopped."""
    endpoint, scene, name, given = sys.argv[1:]
    kind = Kind(**json.loads(given))
    clock, settings = time.time_ns, client_settings([endpoint])
    time.time_ns = lambda: clock() + round(kind.ahead_s * 1e9)
    with Component(role="source", name=name, scene=scene, settings=settings) as component:
        source = Source(component, kind)
        threading.Thread(target=source.listen, daemon=True).start()
        due = logged = time.monotonic()
        while not component.stop.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            # What was missed while this process was stopped is not made up for.
            due = max(due + 1 / source.kind.rate, now)
            if source.faults.paused:
                source.flush()
            else:
                source.send()
            if now - logged > _ACCOUNT_S:
                logged = now
                print(source.account(), flush=True)


if __name__ == "__main__":
    main()
