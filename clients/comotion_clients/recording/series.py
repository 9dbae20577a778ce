"""Writes payloads to one complete MCAP file after the other. The clock is injected."""

import contextlib
import math
import shutil
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from comotion_schemas import DecodeError, Message, TruthBatch, decode_on
from comotion_schemas.keys import Kind
from comotion_schemas.message_log import Logged
from comotion_schemas.recording import LOSSES
from comotion_schemas.sequence import SequenceCounter

from .file import RecordingFile, StorageError

MAX_KEYS = 10_000
"""Payloads on further keys are not recorded: MCAP numbers channels with 16 bits."""
_INDEX_SHARE = 0.02
"""Space kept free for the index, as a share of the file; an index takes well under this."""


@dataclass(frozen=True, kw_only=True)
class SeriesOptions:
    """Path and limits of the files.

    `max_bytes`, `max_seconds`: a new file begins at this size or age; None: a single file.
    `reserve_bytes`: space that remains free on the disk; recording stops before it is used.
    """

    path: Path
    scene: str = "default"
    max_bytes: int | None = None
    max_seconds: float | None = None
    reserve_bytes: int = 64 * 1024 * 1024


class Series:
    """Writes payloads to a sequence of files.

    Every further file starts with the truth so far, logged at its start, so that it can be scored alone.
    The truth of a source is discarded when its session ends.

    Attributes
    ----------
    messages, newest
        Number of messages by kind, and wall clock ns of the newest.
    lost, invalid
        Missing sequence numbers by key, and invalid payloads by reason (recorded as well, except ``limit``:
        too many keys).

    Raises
    ------
    OSError
        If a file exists or cannot be created.
    StorageError
        If the disk is full; the files are intact.
    """

    def __init__(self, options: SeriesOptions) -> None:
        self._options = options
        self.messages, self.lost, self.invalid = Counter[str](), Counter[str](), Counter[str]()
        self.newest: dict[Kind, int] = {}
        self.paths: list[Path] = []
        self._sequences = SequenceCounter()
        self._keys: set[str] = set()
        self._truth: dict[str, list[tuple[bytes, TruthBatch]]] = {}
        self._begun_ns = 0
        self._closed_bytes = 0
        self._check_free_space()
        self._file = self._next_file()

    @property
    def path(self) -> Path:
        """Path of the current file."""
        return self.paths[-1]

    @property
    def file_bytes(self) -> int:
        """Total size of all files in bytes."""
        return self._closed_bytes + self._file.size

    def add(self, arrival: Logged) -> None:
        """Record one payload."""
        if arrival.key not in self._keys and len(self._keys) >= MAX_KEYS:
            self.invalid["limit"] += 1
            return
        self._keys.add(arrival.key)
        message = self._check(arrival)
        self._begun_ns = self._begun_ns or arrival.log_ns
        o, age_ns = self._options, arrival.log_ns - self._begun_ns
        if self._file.size >= (o.max_bytes or math.inf) or age_ns >= 1e9 * (o.max_seconds or math.inf):
            self._rotate(arrival.log_ns)
        self._file.add(arrival.key, arrival.log_ns, arrival.payload, message)
        if isinstance(message, TruthBatch):
            kept = self._truth.setdefault(arrival.key, [])
            if kept and kept[0][1].session != message.session:
                kept.clear()
            kept.append((arrival.payload, message))
        self.messages[arrival.kind] += 1
        self.newest[arrival.kind] = arrival.log_ns

    def flush(self) -> None:
        """Write everything so far to the disk and check the free space."""
        self._file.flush()
        self._check_free_space()

    def close(self, losses: Mapping[str, int] | None = None) -> None:
        """Complete the last file; `losses` go to its metadata."""
        if losses is not None:
            self._file.describe(LOSSES, {name: str(count) for name, count in losses.items()})
        self._file.close()

    def abandon(self) -> None:
        """Complete the last file as far as possible; never raises OSError."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _check(self, arrival: Logged) -> Message | None:
        """Decode a payload and count missing messages and invalid payloads."""
        try:
            message = decode_on(arrival.key, arrival.payload)
        except DecodeError as error:
            self.invalid[error.reason] += 1
            return None
        seq = getattr(message, "seq", None)
        if seq is not None and (lost := self._sequences.sight(arrival.key, message.session, seq).lost):
            self.lost[arrival.key] += lost
        return message

    def _rotate(self, log_ns: int) -> None:
        self._file.close()
        self._closed_bytes += self._file.path.stat().st_size
        self._begun_ns = log_ns
        self._file = self._next_file()
        for key, batches in self._truth.items():
            for payload, truth in batches:
                self._file.add(key, log_ns, payload, truth)

    def _next_file(self) -> RecordingFile:
        o, number = self._options, len(self.paths) + 1
        several = o.max_bytes is not None or o.max_seconds is not None
        path = o.path.with_name(f"{o.path.stem}-{number:03d}{o.path.suffix}") if several else o.path
        self.paths.append(path)
        return RecordingFile(path, scene=o.scene, number=number)

    def _check_free_space(self) -> None:
        folder = self._options.path.parent
        size = self._file.size if self.paths else 0
        needed = self._options.reserve_bytes + round(_INDEX_SHARE * size)
        if (free := shutil.disk_usage(folder).free) < needed:
            raise StorageError(
                f"{folder}: only {free / 2**20:.0f} MiB free, {needed / 2**20:.0f} MiB are to stay free"
            )
