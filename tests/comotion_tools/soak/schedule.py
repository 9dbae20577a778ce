"""Draws the faults of a soak from a seed: what happens to which process, and when."""

import random
from dataclasses import dataclass

from comotion_deploy.errors import UserError

from .attacks import ATTACKS, NAME

SOURCES = ("left", "right", "arm", "camera")
"""The well-behaved sources; the first three observe the same bodies."""
OTHERS = ("router", "service", "recorder", "viewer")
HOSTILE = NAME

KINDS: dict[str, tuple[float, tuple[str, ...]]] = {
    "kill": (3.0, (*SOURCES, *OTHERS)),
    "stop": (2.0, (*SOURCES, *OTHERS)),
    "restart": (1.0, (*SOURCES, *OTHERS)),
    "clock": (2.0, SOURCES),
    "burst": (1.0, SOURCES),
    "loss": (1.0, SOURCES),
    "disorder": (1.0, SOURCES),
    "churn": (1.0, SOURCES),
    HOSTILE: (2.0, (HOSTILE,)),
}
"""Kinds of faults, their weight, and the processes that they may happen to."""
_CLOCK_STEPS_S = (-3600.0, -1.0, 1.0, 3600.0)
# Until all is in its place at the start, and after the last fault.
LEAD_S, TAIL_S = 8.0, 12.0
_PAUSE_S = (4.0, 12.0)
_LASTS_S = {
    "stop": (1.0, 12.0),
    "clock": (3.0, 10.0),
    "loss": (3.0, 8.0),
    "disorder": (3.0, 8.0),
    HOSTILE: (4.0, 4.0),
}
_BURST = (50, 200)


@dataclass(frozen=True)
class Fault:
    """What happens to which process, s from the start of the soak."""

    at_s: float
    kind: str
    target: str
    lasts_s: float = 0.0  # 0 for what happens at once
    size: float = 0.0  # step of the clock in s, or batches of a burst

    @property
    def blurs(self) -> bool:
        """Whether accounts cannot be exact across it: a process takes with it what only it knew."""
        ends = self.kind in ("kill", "restart") and self.target in (*SOURCES, "service")
        return ends or self.kind == HOSTILE

    def __str__(self) -> str:
        size = f" {self.size:+g}" if self.kind == "clock" else ""
        return f"{self.kind}{size} {self.target}" + (f" for {self.lasts_s:.0f} s" if self.lasts_s else "")


def draw(seed: int, duration_s: float, kind: str = "", target: str = "") -> list[Fault]:
    """Draw the faults of a soak, or those of a kind or a target alone; the same for the same arguments.

    Of the kind ``none`` there is none. Targets of hostile ones are attacks, too.

    Raises
    ------
    UserError
        If no fault is of this kind and target.
    """
    chance, at_s = random.Random(seed), LEAD_S
    targets = {name: {"", *of, *(ATTACKS if name == HOSTILE else ())} for name, (_, of) in KINDS.items()}
    fitting = {name: w for name, (w, _) in KINDS.items() if kind in {"", name} and target in targets[name]}
    if kind == "none":
        return []
    if not fitting:
        raise UserError(f"no fault {kind!r} of {target!r}; kinds are none, {', '.join(KINDS)}")
    faults = []
    while at_s < duration_s - TAIL_S:
        (name,) = chance.choices([*fitting], [*fitting.values()])
        lasts_s = round(chance.uniform(*_LASTS_S.get(name, (0.0, 0.0))), 1)
        size = 0.0
        if name == "clock":
            size = chance.choice(_CLOCK_STEPS_S)
        elif name == "burst":
            size = chance.randint(*_BURST)
        whose = target or chance.choice(KINDS[name][1])
        faults.append(Fault(round(at_s, 1), name, whose, lasts_s, size))
        at_s += lasts_s + chance.uniform(*_PAUSE_S)
    return faults
