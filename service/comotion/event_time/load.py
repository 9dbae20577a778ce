"""Batches that wait in; whether their source may have one more, out."""

from ..config import FusionConfig
from .instants import Entry

_MEGABYTE = 1_000_000


class Load:
    """What waits of each source, and of all, against its bounds."""

    def __init__(self, config: FusionConfig) -> None:
        limits = config.limits
        self._batches = limits.waiting_batches
        self._bytes = round(limits.waiting * _MEGABYTE)
        self._all = round(limits.waiting_all * _MEGABYTE)
        self._held: dict[str, list[int]] = {}
        self._total = 0

    def admits(self, entry: Entry) -> bool:
        """Whether there is room for one more batch of its source."""
        batches, size = self._held.get(entry.batch.source, (0, 0))
        share = self._bytes
        if self._total + entry.size > self._all:
            share = min(share, self._all // max(len(self._held), 1))
        return batches < self._batches and size + entry.size <= share

    def add(self, entry: Entry) -> None:
        """Take a batch in."""
        held = self._held.setdefault(entry.batch.source, [0, 0])
        held[0] += 1
        held[1] += entry.size
        self._total += entry.size

    def remove(self, entry: Entry) -> None:
        """A batch waits no more."""
        held = self._held[entry.batch.source]
        held[0] -= 1
        held[1] -= entry.size
        self._total -= entry.size
        if not held[0]:
            del self._held[entry.batch.source]

    def holds(self, source: str) -> bool:
        """Whether anything of a source waits."""
        return source in self._held
