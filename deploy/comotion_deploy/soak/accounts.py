"""What the sources have sent and what the service has counted in; whether they agree out.

An audit compares two moments at which all sources paused and the service had time to count: what was sent in
between is what the service received or knows to be lost. Between them the same service must have run.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from comotion_schemas import Status

from .processes import Managed

_FATES = ("fused", "partly_late", "late", "duplicates", "overflow", "waiting")


@dataclass(frozen=True)
class Moment:
    """A moment at which all sources paused.

    Attributes
    ----------
    service
        Session of the service.
    sent
        Sequence numbers used, by source and session, and batches sent again.
    received, lost
        Batches that the service counts.
    unsettled
        Batches that the service counts as received and in no fate.
    """

    service: str
    sent: dict[tuple[str, str], int]
    received: int
    lost: int
    unsettled: int


@dataclass(frozen=True)
class Audit:
    """Two moments compared.

    Attributes
    ----------
    sent
        Batches sent in between, with those that were lost on purpose and those that were sent again.
    missing
        Sent, but neither received nor known to be lost; negative: counted twice.
    unsettled
        Received, but in no fate.
    is_exact
        Whether no source ended in between: what a killed process has handed over last, nobody knows.
    """

    sent: int
    missing: int
    unsettled: int
    is_exact: bool


def moment(status: Status, sources: Iterable[Managed]) -> Moment:
    """Take down the accounts of a moment."""
    told = [(one.name, one.account) for one in sources if "session" in one.account]
    counters = status.counters
    refused = sum(status.rejected.values())
    received = counters.get("batches", 0)
    settled = sum(counters.get(name, 0) for name in _FATES) + refused
    return Moment(
        service=status.session,
        sent={(name, account["session"]): account["sent"] + account["repeated"] for name, account in told},
        received=received,
        lost=counters.get("lost", 0),
        unsettled=received - settled if "fused" in counters else 0,
    )


def audit(before: Moment, after: Moment) -> Audit | None:
    """Compare two moments; None if another service ran in between."""
    if before.service != after.service:
        return None
    sent = sum(count - before.sent.get(key, 0) for key, count in after.sent.items())
    seen = after.received - before.received + after.lost - before.lost
    return Audit(sent, sent - seen, after.unsettled, before.sent.keys() == after.sent.keys())
