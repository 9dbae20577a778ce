"""What has happened to the hypotheses from one partition to the next."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event

from ..partition import NO_HYPOTHESIS


@dataclass(frozen=True)
class Membership:
    """Who belongs where: `tracks` int64 [n], distinct, and `labels` int64 [n] (hypothesis or -1).

    Outdated trajectories that may come back are part of it: a hypothesis lives as long as they do.
    """

    tracks: NDArray[np.int64]
    labels: NDArray[np.int64]

    @cached_property
    def hypotheses(self) -> list[int]:
        """Those that have members, ascending."""
        return [h for h in np.unique(self.labels).tolist() if h != NO_HYPOTHESIS]

    @classmethod
    def empty(cls) -> "Membership":
        """Nobody."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64))


def changes(stamp_ns: int, before: Membership, after: Membership) -> list[Event]:
    """Events between two memberships (docs/protocol.md, HypothesisUpdate), by kind and id.

    A hypothesis that is new: ``split`` if no fewer of its members left some old hypothesis than came
    from nowhere, else ``born``. One that is gone: ``merged`` if no fewer of its members went to some
    other old hypothesis than went nowhere, else ``ended``.
    """
    was, now = before.hypotheses, after.hypotheses
    if was == now:
        return []
    tracks = np.union1d(before.tracks, after.tracks)
    old, new = _align(tracks, before), _align(tracks, after)
    events = [_beginning(stamp_ns, h, old[new == h]) for h in now if h not in set(was)]
    survivors = set(was) & set(now)
    merged: dict[int, list[int]] = {}
    ended: list[int] = []
    for gone in was:
        if gone in survivors:
            continue
        heir = _most(new[old == gone], survivors)
        if heir is None:
            ended.append(gone)
        else:
            merged.setdefault(heir, []).append(gone)
    events += [
        Event(stamp_ns=stamp_ns, kind="merged", hypothesis=h, others=merged[h]) for h in sorted(merged)
    ]
    return events + [Event(stamp_ns=stamp_ns, kind="ended", hypothesis=h, others=[]) for h in ended]


def _align(tracks: NDArray[np.int64], membership: Membership) -> NDArray[np.int64]:
    labels = np.full(len(tracks), NO_HYPOTHESIS)
    labels[np.searchsorted(tracks, membership.tracks)] = membership.labels
    return labels


def _beginning(stamp_ns: int, hypothesis: int, origins: NDArray[np.int64]) -> Event:
    parent = _most(origins, None)
    if parent is None:
        return Event(stamp_ns=stamp_ns, kind="born", hypothesis=hypothesis, others=[])
    return Event(stamp_ns=stamp_ns, kind="split", hypothesis=hypothesis, others=[parent])


def _most(labels: NDArray[np.int64], among: set[int] | None) -> int | None:
    """The most frequent hypothesis, the oldest of equals; None where more have none."""
    found, counts = np.unique(labels, return_counts=True)
    votes = {int(h): int(c) for h, c in zip(found, counts, strict=True)}
    nowhere = votes.pop(NO_HYPOTHESIS, 0)
    eligible = {h: c for h, c in votes.items() if among is None or h in among}
    best = max(eligible, key=lambda h: (eligible[h], -h), default=None)
    return best if best is not None and eligible[best] >= nowhere else None
