"""A running scene with two honest sources and one that attacks; out comes what the attack costs the honest.

Router, service, sources and attacker are processes of their own. The honest are the sources of the soak.
"""

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

from zenoh.handlers import RingChannel

from comotion_clients.subscription import Subscription
from comotion_deploy.demo import free_endpoint
from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.grants import CertificateRole, Grant
from comotion_deploy.processes import PYTHON
from comotion_schemas import UNDETERMINED, HypothesisUpdate, Keys, Status, decode_as
from comotion_schemas.tls import ENVIRONMENT
from comotion_schemas.transport import client_settings, connect
from comotion_tools.soak.attacks import NAME
from comotion_tools.soak.load import ID_STEP
from comotion_tools.soak.processes import Managed, system

SCENE = "arena"
HONEST = ("left", "right")
DEADLINE_S = 600.0
COLUMNS = "attack, longest gap, updates, lost of sent, renamed, MB before / most / after, load, named"
BOUND_S = 0.5
"""Longest gap between updates that an attack may cause while the load of the machine is below two."""
_POLL_S = 0.02
# The trajectories of an attack leave the window, and housekeeping comes by.
_GIVEN_BACK_S = 22.0
# The honest pause before an attack, for their accounts.
_PAUSED = {("silent", name) for name in HONEST}


@dataclass
class Outcome:
    """What happened during an attack.

    Attributes
    ----------
    attack, seconds, did
        Which one, how long, and how many messages or tokens the attacker has sent.
    gap_s
        Longest time between two updates.
    lost
        Batches of the honest sources that were sent and not fused, and the number sent.
    problems
        Kind and source of the problems that the Status named.
    told_lost
        Batches of the honest that the service says are lost.
    renamed
        Bodies that most features of the honest have under another id than before.
    memory_mb
        Of the service: before, at most, and 25 s after.
    load
        Of the machine over the last minute.
    """

    attack: str
    seconds: float
    did: int = 0
    gap_s: float = 0.0
    updates: int = 0
    lost: int = 0
    sent: int = 0
    problems: set[tuple[str, str | None]] = field(default_factory=set)
    told_lost: int = 0
    renamed: int = 0
    memory_mb: tuple[float, ...] = ()
    load: float = 0.0

    def __str__(self) -> str:
        cells = [
            self.attack,
            f"{self.gap_s:.2f} s",
            str(self.updates),
            f"{self.lost} of {self.sent}",
            str(self.renamed),
            " / ".join(f"{one:.0f}" for one in self.memory_mb),
            f"{self.load:.1f}",
            ", ".join(sorted(f"`{kind}` {who or ''}".strip() for kind, who in self.problems)) or "-",
        ]
        return f"| {' | '.join(cells)} |"

    @property
    def blames_the_honest(self) -> bool:
        return any(who in HONEST for _, who in self.problems)

    def names_the_attacker(self, *kinds: str) -> bool:
        """Whether one of some kinds of problem is laid to the attacker, or to a name that it has taken."""
        return any(kind in kinds and (who or "").startswith(NAME) for kind, who in self.problems)


def _certificates(folder: Path) -> Path:
    """Certificates of all processes."""
    authority = Authority.create(folder)
    roles: dict[str, CertificateRole] = {"hall": "router", "fusion": "service"}
    for name, role in (roles | dict.fromkeys((*HONEST, NAME), "source")).items():
        sources = (name,) if role == "source" else ()
        grant = Grant(role=role, name=name, common_name="new", scene=SCENE, sources=sources)
        authority.issue(grant, hosts=("localhost", "127.0.0.1") if role == "router" else ())
    return folder


class Arena:
    """The processes of a scene; a context manager.

    `held`: the honest start only with :meth:`begin`; `also`: further sources of the soak; `secure`: all have
    certificates, the attacker an ordinary one; `serve`: further options of the service.
    """

    def __init__(
        self,
        folder: Path,
        *,
        held: bool = False,
        also: tuple[str, ...] = (),
        secure: bool = False,
        serve: tuple[str, ...] = (),
    ) -> None:
        self.endpoint = free_endpoint()
        self._tls: Path | None = None
        if secure:
            self.endpoint = self.endpoint.replace("tcp/127.0.0.1", "tls/localhost")
            self._tls = _certificates(folder / "pki")
        every = system(self.endpoint, SCENE, folder, serve=serve)
        self._also = also
        self.processes = {name: every[name] for name in ("router", "service", *HONEST, *also)}
        self._folder, self._held = folder, held
        if self._tls is not None:
            for process in self.processes.values():
                process.command = self._with_certificate(process.name, process.command)
            router = (*PYTHON, "comotion_deploy", "router", "--secure", str(self._tls))
            self.processes["router"].command = (
                *router,
                "--listen",
                self.endpoint.replace("localhost", "127.0.0.1"),
            )
        self._exit = ExitStack()
        self._arrived: list[float] = []
        self.status: Status | None = None
        self.last: HypothesisUpdate | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            for name in ("router", "service"):
                self._start(name, stack)
            self.session = stack.enter_context(
                # That of a router may see everything.
                connect(client_settings([self.endpoint], self._tls and self._tls / "hall"), timeout=60)
            )
            self._updates = stack.enter_context(Subscription(self.session, HypothesisUpdate, SCENE))
            key = Keys(SCENE).stream("status", "fusion")
            self._statuses = self.session.declare_subscriber(key, RingChannel(16))
            self.until(lambda: self.last is not None)
            if not self._held:
                self.begin(stack)
            self._exit = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._exit.close()

    def _with_certificate(self, name: str, command: tuple[str, ...]) -> tuple[str, ...]:
        if self._tls is None:
            return command
        own = "fusion" if name == "service" else name
        return ("env", f"{ENVIRONMENT}={self._tls / own}", *command)

    def _start(self, name: str, stack: ExitStack | None = None) -> None:
        self.processes[name].start()
        (stack or self._exit).callback(self.processes[name].end)

    def begin(self, stack: ExitStack | None = None) -> None:
        """Start the honest sources and wait until both are fused."""
        for name in (*HONEST, *self._also):
            self._start(name, stack)
        self.until(lambda: {one.name for one in self.last.sources} >= set(HONEST))
        self.watch(3.0)

    def until(self, fulfilled: Callable[[], bool]) -> None:
        end = time.monotonic() + DEADLINE_S
        while not fulfilled():
            assert time.monotonic() < end, self.processes["service"].log.read_text()[-3000:]
            self._poll()

    def watch(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._poll()

    def _poll(self) -> None:
        time.sleep(_POLL_S)
        for at, update in self._updates.drain():
            self._arrived.append(at)
            self.last = update
        while (sample := self._statuses.try_recv()) is not None:
            self.status = decode_as(Status, sample.payload.to_bytes())

    @contextmanager
    def attacked_by(self, name: str, seconds: float) -> Iterator[Managed]:
        """Let the attacker run for some seconds, at most as long as the block."""
        command = (*PYTHON, "comotion_tools.soak.hostile", self.endpoint, SCENE, str(seconds), "0", name)
        attacker = Managed(NAME, self._with_certificate(NAME, command), self._folder)
        attacker.start()
        try:
            self.until(lambda: "sent" in attacker.account)
            yield attacker
        finally:
            attacker.end()

    def attack(self, name: str, seconds: float) -> Outcome:
        """Attack for some seconds; the figures are of that time and the three seconds after it."""
        label = f"{name}, certificates" if self._tls else name
        outcome = Outcome(label, seconds, load=os.getloadavg()[0])
        before = self._accounts()
        memory, ids = [self._memory()], self._ids()
        with self.attacked_by(name, seconds) as attacker:
            del self._arrived[:-1]
            end = time.monotonic() + seconds + 3.0
            while time.monotonic() < end:
                self._poll()
                memory.append(self._memory())
                if self.status is not None:
                    found = {(one.kind, one.source) for one in self.status.problems}
                    outcome.problems |= found - _PAUSED
        now = self._ids()
        outcome.renamed = sum(now.get(body) != one for body, one in ids.items())
        arrived = [*self._arrived, time.monotonic()]
        outcome.gap_s = max(b - a for a, b in pairwise(arrived))
        outcome.updates, outcome.did = len(arrived) - 2, attacker.account["sent"]
        after = self._accounts()
        outcome.sent = after[0] - before[0]
        outcome.lost = outcome.sent - (after[1] - before[1])
        outcome.told_lost = sum(one["lost"] or 0 for one in self.accounts() if one["source"] in HONEST)
        self.watch(_GIVEN_BACK_S)
        outcome.memory_mb = (memory[0], max(memory), self._memory())
        return outcome

    def _ids(self) -> dict[int, int]:
        """Hypothesis of each body, as most features of the honest have it."""
        votes: dict[int, Counter[int]] = {}
        update = self.last
        assert update is not None
        rows = zip(update.track_source, update.track_id, update.track_hypothesis, strict=True)
        for source, feature, hypothesis in rows:
            if update.sources[source].name in HONEST and hypothesis != UNDETERMINED:
                votes.setdefault(int(feature) // ID_STEP, Counter())[int(hypothesis)] += 1
        return {body: counts.most_common(1)[0][0] for body, counts in votes.items()}

    def _memory(self) -> float:
        usage = self.processes["service"].usage()
        return 0.0 if usage is None else usage.memory_mb

    def _accounts(self) -> tuple[int, int]:
        """Batches that the honest have sent, and those fused, once all is counted; they pause meanwhile."""
        honest = [self.processes[name] for name in HONEST if self.processes[name].account]
        for one in honest:
            one.send({"do": "pause"})
        self.until(lambda: all(one.account.get("paused") for one in honest))
        self.watch(2.5)
        sessions = {(one.name, one.account["session"]) for one in honest}
        fused = [one["fused"] for one in self.accounts() if (one["source"], one["session"]) in sessions]
        sent = sum(one.account["sent"] for one in honest)
        for one in honest:
            one.send({"do": "resume"})
        self.until(lambda: not any(one.account.get("paused") for one in honest))
        self.watch(1.0)
        return sent, sum(fused)

    def accounts(self) -> list[dict[str, Any]]:
        """What the service says became of the batches of every session."""
        for reply in self._replies():
            return list(json.loads(reply)["accounts"])
        raise AssertionError("the service answers no query")

    def _replies(self) -> Iterator[bytes]:
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            for reply in self.session.get(f"{Keys(SCENE).prefix}/query/accounts", timeout=5.0):
                if reply.ok is not None:
                    yield reply.ok.payload.to_bytes()
