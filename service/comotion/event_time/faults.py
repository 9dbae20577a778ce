"""Collects errors of the service and their sources. A fault costs a batch or a space, not the service."""

import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from comotion_schemas import ObservationBatch

from .stats import Stats

# Unread faults that are kept.
_MOST_FAULTS = 32


@dataclass(frozen=True)
class Fault:
    """One error of the service itself: what it was `doing`, and the exception with its trace."""

    doing: str
    error: Exception


class Faults:
    """Collects the faults of a fusion, and counts them."""

    def __init__(self, stats: Stats) -> None:
        self._stats = stats
        self._unread: deque[Fault] = deque(maxlen=_MOST_FAULTS)

    @contextmanager
    def guard(self, doing: str, batch: ObservationBatch | None = None) -> Iterator[list[Exception]]:
        """Go on behind a block that does `doing` if it fails; yields a list that gets the exception."""
        failed: list[Exception] = []
        try:
            yield failed
        except Exception as error:
            failed.append(error)
            self._stats.faults += 1
            if batch is not None:
                rows = f"{len(batch.ids)} rows, space {batch.space!r}"
                doing += f" (source {batch.source}, seq {batch.seq}, {rows})"
            self._unread.append(Fault(doing, error))

    def take(self) -> list[Fault]:
        """The faults since the last call."""
        faults = list(self._unread)
        self._unread.clear()
        return faults

    def warn(self, stacklevel: int) -> None:
        """Warn of each of those, for callers without a log; `stacklevel` is that of a warning there."""
        for fault in self.take():
            text = f"a defect of comotion, please report it: {fault.doing}: {fault.error!r}"
            warnings.warn(text, RuntimeWarning, stacklevel=stacklevel + 1)
