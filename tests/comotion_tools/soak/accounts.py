"""Compares what the sources have sent with what the service has counted.

An audit compares two moments at which all sources paused and the service had time to count: what was sent in
between is what the service received or knows to be lost. Between them the same service must have run.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..processes import Managed

_FATES = ("fused", "partly_late", "late", "duplicates", "overflow", "waiting")


@dataclass(frozen=True)
class Moment:
    """A moment at which all sources paused."""

    service: str  # its session
    # Sequence numbers used, by source and session, and batches sent again.
    sent: dict[tuple[str, str], int]
    # Batches of these sources that the service counts. What others send, hostile ones too, is none of it.
    received: int
    lost: int
    waiting: int
    # Of anybody: received and in no fate.
    unsettled: int
    # Sent, and unknown to the service yet: after its start, until it hears of each source.
    unheard: int = 0


@dataclass(frozen=True)
class Audit:
    """Two moments compared: batches sent in between, those lost on purpose and sent again too."""

    sent: int
    missing: int  # neither received nor known to be lost; negative: counted twice
    unsettled: int  # received, but in no fate
    # Whether no source ended in between: what a killed process has handed over last, nobody knows.
    is_exact: bool


def moment(service: str, reply: Mapping[str, Any], sources: Iterable[Managed]) -> Moment:
    """Take down a moment: what a service says, by its session, and the sources of what they have sent."""
    reported = ((one.name, one.account) for one in sources if "session" in one.account)
    declared = {(name, account["session"]): account for name, account in reported}
    # A source whose session is not known has overflowed before anything of it was read.
    known = declared.keys() | {(name, "") for name, _ in declared}
    mine = [one for one in reply["accounts"] if (one["source"], one["session"]) in known]
    sent = {key: account["sent"] + account["repeated"] for key, account in declared.items()}
    heard: dict[str, int] = {}
    for one in mine:
        heard[one["source"]] = heard.get(one["source"], 0) + one["batches"] + (one["lost"] or 0)
    total = reply["total"]
    settled = sum(total[fate] for fate in _FATES) + sum(total["rejected"].values())
    return Moment(
        service=service,
        sent=sent,
        received=sum(one["batches"] for one in mine),
        lost=sum(one["lost"] or 0 for one in mine),
        waiting=sum(one["waiting"] for one in mine),
        unsettled=total["batches"] - settled,
        unheard=sum(max(count - heard.get(name, 0), 0) for (name, _), count in sent.items()),
    )


def audit(before: Moment, after: Moment) -> Audit | None:
    """Compare two moments; None if another service ran in between."""
    if before.service != after.service:
        return None
    sent = sum(count - before.sent.get(key, 0) for key, count in after.sent.items())
    seen = after.received - before.received + after.lost - before.lost
    return Audit(sent, sent - seen, after.unsettled, before.sent.keys() == after.sent.keys())
