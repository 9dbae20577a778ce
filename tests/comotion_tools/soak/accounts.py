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
    """A moment at which all sources paused.

    Attributes
    ----------
    service
        Session of the service.
    sent
        Sequence numbers used, by source and session, and batches sent again.
    received, lost, waiting
        Batches of these sources that the service counts. What others send, hostile ones too, is none of it.
    unsettled
        Batches of anybody that the service counts as received and in no fate.
    unheard
        Batches sent of which the service knows nothing yet: after its start, until it hears of each source.
    """

    service: str
    sent: dict[tuple[str, str], int]
    received: int
    lost: int
    waiting: int
    unsettled: int
    unheard: int = 0


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


def moment(service: str, reply: Mapping[str, Any], sources: Iterable[Managed]) -> Moment:
    """Take down the accounts of a moment.

    Parameters
    ----------
    service
        Session of the service.
    reply
        To its query ``accounts``.
    sources
        The sources, with what they say that they have sent.
    """
    declared = {
        (one.name, one.account["session"]): one.account for one in sources if "session" in one.account
    }
    # A source whose session is not known has overflowed before anything of it was read.
    known = declared.keys() | {(name, "") for name, _ in declared}
    mine = [one for one in reply["accounts"] if (one["source"], one["session"]) in known]
    sent = {key: account["sent"] + account["repeated"] for key, account in declared.items()}
    heard: dict[str, int] = {}
    for one in mine:
        heard[one["source"]] = heard.get(one["source"], 0) + one["batches"] + (one["lost"] or 0)
    return Moment(
        service=service,
        sent=sent,
        received=sum(one["batches"] for one in mine),
        lost=sum(one["lost"] or 0 for one in mine),
        waiting=sum(one["waiting"] for one in mine),
        unsettled=reply["total"]["batches"] - _settled(reply["total"]),
        unheard=sum(max(count - heard.get(name, 0), 0) for (name, _), count in sent.items()),
    )


def _settled(account: Mapping[str, Any]) -> int:
    return int(sum(account[name] for name in _FATES) + sum(account["rejected"].values()))


def audit(before: Moment, after: Moment) -> Audit | None:
    """Compare two moments; None if another service ran in between."""
    if before.service != after.service:
        return None
    sent = sum(count - before.sent.get(key, 0) for key, count in after.sent.items())
    seen = after.received - before.received + after.lost - before.lost
    return Audit(sent, sent - seen, after.unsettled, before.sent.keys() == after.sent.keys())
