"""A running scene with two honest sources and one that attacks; out comes what the attack costs the honest.

Router, service, sources and attacker are processes of their own. The honest are the sources of the soak.
"""

import os
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from comotion_deploy.demo import free_endpoint
from comotion_schemas import UNDETERMINED
from comotion_schemas.tls import ENVIRONMENT
from comotion_schemas.transport import client_settings
from comotion_tools.processes import COMOTION
from comotion_tools.soak.attacks import NAME
from comotion_tools.soak.monitor import Watched, votes
from comotion_tools.soak.run import hostile, system
from comotion_tools.system import certificates

SCENE = "arena"
HONEST = ("left", "right")
DEADLINE_S = 600.0
COLUMNS = "attack, longest gap, updates, lost of sent, renamed, MB before / most / after, load, named"
BOUND_S = 0.5
"""Longest gap between updates that an attack may cause while the load of the machine is below two."""
# The trajectories of an attack leave the window, and housekeeping comes by.
_GIVEN_BACK_S = 22.0
# The honest pause before an attack, for their accounts.
_PAUSED = {("silent", name) for name in HONEST}


@dataclass
class Outcome:
    """What happened during an attack: by cells of a table.

    `gap_s`: longest time between two updates. `lost`: batches of the honest that were sent and not fused, of
    `sent`; `told_lost`: of those, what the service says is lost. `problems`: kind and source, as the Status
    named them. `renamed`: bodies that most features of the honest have under another id than before.
    `memory_mb`: of the service, before, at most, and 25 s after. `load`: of the machine over the last minute.
    """

    attack: str
    gap_s: float = 0.0
    updates: int = 0
    lost: int = 0
    sent: int = 0
    problems: set[tuple[str, str | None]] = field(default_factory=set)
    told_lost: int = 0
    renamed: int = 0
    memory_mb: tuple[float, ...] = ()
    load: float = 0.0

    def __str__(self):
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
    def blames_the_honest(self):
        return any(who in HONEST for _, who in self.problems)

    def names_the_attacker(self, *kinds):
        """Whether one of some kinds of problem is laid to the attacker, or to a name that it has taken."""
        return any(kind in kinds and (who or "").startswith(NAME) for kind, who in self.problems)


class Arena(Watched):
    """The processes of a scene; a context manager.

    `also`: further sources of the soak; `secure`: all have certificates, the attacker an ordinary one;
    `serve`: further options of the service.
    """

    turn_s = 0.02

    def __init__(self, folder, *, also=(), secure=False, serve=()):
        self.endpoint = free_endpoint()
        self._tls: Path | None = None
        if secure:
            self.endpoint = self.endpoint.replace("tcp/127.0.0.1", "tls/localhost")
            roles = {"hall": "router", "fusion": "service", **dict.fromkeys((*HONEST, NAME), "source")}
            self._tls = certificates(folder / "pki", roles, scene=SCENE).folder
        self._folder, self._sources = folder, (*HONEST, *also)
        every = system(self.endpoint, SCENE, folder, serve=serve)
        processes = {name: self._certified(every[name]) for name in ("router", "service", *self._sources)}
        if self._tls is not None:
            at = ("--listen", self.endpoint.replace("localhost", "127.0.0.1"))
            processes["router"].command = (*COMOTION, "router", "--secure", str(self._tls), *at)
        # That of a router may see everything.
        settings = client_settings([self.endpoint], self._tls and self._tls / "hall")
        super().__init__(processes, SCENE, settings)

    def __enter__(self):
        super().__enter__()
        try:
            self.start("service")
            self.until(lambda: self.last is not None)
            self.start(*self._sources)
            self.until(lambda: {one.name for one in self.last.sources} >= set(HONEST))
            self.wait(3.0)
        except BaseException:
            self.__exit__()
            raise
        return self

    @property
    def last(self):
        """The last update."""
        return self.monitor.last

    def _certified(self, process):
        """The process with a certificate of its own, where all have some."""
        if self._tls is not None:
            own = "fusion" if process.name == "service" else process.name
            process.command = ("env", f"{ENVIRONMENT}={self._tls / own}", *process.command)
        return process

    @contextmanager
    def attacked_by(self, name, seconds):
        """Let the attacker run for some seconds, at most as long as the block."""
        attacker = self._certified(hostile(self.endpoint, SCENE, self._folder, seconds, 0, name))
        attacker.start()
        try:
            self.until(lambda: "sent" in attacker.account)
            yield
        finally:
            attacker.end()

    def attack(self, name, seconds):
        """Attack for some seconds; the figures are of that time and the three seconds after it."""
        label = f"{name}, certificates" if self._tls else name
        outcome = Outcome(label, load=os.getloadavg()[0])
        before = self.counted()
        memory, ids = [self._memory()], self._ids()
        with self.attacked_by(name, seconds):
            del self.monitor.arrived_s[:-1]
            end = time.monotonic() + seconds + 3.0
            while time.monotonic() < end:
                self.turn()
                memory.append(self._memory())
                outcome.problems |= self.problems() - _PAUSED
        now = self._ids()
        outcome.renamed = sum(now.get(body) != one for body, one in ids.items())
        arrived = [*self.monitor.arrived_s, time.monotonic()]
        outcome.gap_s = max(b - a for a, b in pairwise(arrived))
        outcome.updates = len(arrived) - 2
        after = self.counted()
        outcome.sent = after[0] - before[0]
        outcome.lost = outcome.sent - (after[1] - before[1])
        outcome.told_lost = sum(one["lost"] or 0 for one in self.sessions() if one["source"] in HONEST)
        self.wait(_GIVEN_BACK_S)
        outcome.memory_mb = (memory[0], max(memory), self._memory())
        return outcome

    def problems(self):
        """Kind and source of the problems that the service names now."""
        status = self.monitor.status
        return set() if status is None else {(one.kind, one.source) for one in status.problems}

    def _ids(self):
        """Hypothesis of each body, as most features of the honest have it."""
        assert self.last is not None
        found = votes(self.last, HONEST)
        for counts in found.values():
            del counts[UNDETERMINED]
        return {body: counts.most_common(1)[0][0] for body, counts in found.items() if counts}

    def _memory(self):
        usage = self.processes["service"].usage()
        return 0.0 if usage is None else usage.memory_mb

    def counted(self):
        """Batches that the honest have sent, and those fused, once all is counted; they pause meanwhile."""
        honest = [self.processes[name] for name in HONEST if self.processes[name].account]
        with self.paused(honest):
            self.until(lambda: all(one.account.get("paused") for one in honest))
            self.wait(2.5)
            mine = {(one.name, one.account["session"]) for one in honest}
            fused = [one["fused"] for one in self.sessions() if (one["source"], one["session"]) in mine]
            sent = sum(one.account["sent"] for one in honest)
        self.until(lambda: not any(one.account.get("paused") for one in honest))
        self.wait(1.0)
        return sent, sum(fused)

    def sessions(self):
        """What the service says became of the batches of every session."""
        end = time.monotonic() + DEADLINE_S
        while (found := self.accounts(5.0)) is None:
            assert time.monotonic() < end, "the service answers no query"
        return list(found["accounts"])
