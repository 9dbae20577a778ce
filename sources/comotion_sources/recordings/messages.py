"""Recorded scenes (MCAP) -> messages of their sources. Needs the extra `record`."""

from collections.abc import Iterator
from pathlib import Path
from typing import cast

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.message_log import Logged, MessageLog

__all__ = ["Logged", "MessageLog", "logged_batches"]


def logged_batches(path: str | Path) -> Iterator[tuple[int, TruthBatch | ObservationBatch]]:
    """Yield (receipt in ns, message) for all valid observations and truth of a recording.

    Raises
    ------
    RecordingError
        As :class:`MessageLog`.
    """
    with MessageLog(Path(path)) as log:
        # Of these kinds there are no other messages.
        yield from cast("Iterator[tuple[int, TruthBatch | ObservationBatch]]", log.decoded({"obs", "truth"}))
