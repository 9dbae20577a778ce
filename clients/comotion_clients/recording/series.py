"""A recording as a series of files, each whole in itself. The clock is injected."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from comotion_schemas import QOS, DecodeError, Message, TruthBatch, decode
from comotion_schemas.keys import last_chunk
from comotion_schemas.qos import Kind
from comotion_schemas.recording import LOSSES
from comotion_schemas.sequence import SequenceCounter

from .disk import free_bytes
from .file import RecordingFile, StorageError

MAX_KEYS = 10_000
"""What comes on further keys is refused: MCAP numbers its channels with 16 bits."""
_INDEX_SHARE = 0.02
"""An index takes well under this share of its file."""


class Arrival(NamedTuple):
    """One payload: on which key it came, when (wall clock, ns), and what it was."""

    kind: Kind
    key: str
    log_ns: int
    payload: bytes


@dataclass(frozen=True, kw_only=True)
class SeriesOptions:
    """Where to and how long a file may become.

    `max_bytes`, `max_seconds`: begin a new file at this size or age; None: one file only.
    `reserve_bytes`: room on the disk that is left to others; recording stops before it is touched.
    """

    path: Path
    scene: str = "default"
    max_bytes: int | None = None
    max_seconds: float | None = None
    reserve_bytes: int = 64 * 1024 * 1024


@dataclass
class Tally:
    """What has been recorded.

    `lost`: gaps in the sequence numbers of a stream, by key; `invalid`: payloads by the reason why
    they are not valid (they are recorded all the same, but for ``limit``: one key too many);
    `newest`: wall clock ns of a kind's last one.
    """

    messages: dict[Kind, int] = field(default_factory=dict)
    newest: dict[Kind, int] = field(default_factory=dict)
    payload_bytes: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    invalid: dict[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Messages of all kinds."""
        return sum(self.messages.values())


class Series:
    """Writes what arrives into one file after the other.

    A file that is not the first starts with the truth known so far, stamped with its own beginning,
    so that it can be scored alone. A source's truth is forgotten when its session ends.

    Raises
    ------
    OSError
        If a file exists or cannot be made.
    StorageError
        If the disk is full; what is in the files is intact.
    """

    def __init__(self, options: SeriesOptions) -> None:
        self._options = options
        self.tally = Tally()
        self.paths: list[Path] = []
        self._sequences = SequenceCounter()
        self._keys: set[str] = set()
        self._truth: dict[str, tuple[str, list[tuple[bytes, TruthBatch]]]] = {}
        self._begun_ns: int | None = None
        self._closed_bytes = 0
        self._require_room()
        self._file = self._next_file()

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self.paths[-1]

    @property
    def file_bytes(self) -> int:
        """Bytes in all files."""
        return self._closed_bytes + self._file.size

    def add(self, arrival: Arrival) -> None:
        """Record one payload."""
        if not self._admits(arrival.key):
            self.tally.invalid["limit"] = self.tally.invalid.get("limit", 0) + 1
            return
        message = self._check(arrival)
        if self._begun_ns is None:
            self._begun_ns = arrival.log_ns
        if self._is_full(arrival.log_ns):
            self._rotate(arrival.log_ns)
        self._file.add(arrival.key, arrival.log_ns, arrival.payload, message)
        if isinstance(message, TruthBatch):
            self._remember(arrival, message)
        t = self.tally
        t.messages[arrival.kind] = t.messages.get(arrival.kind, 0) + 1
        t.newest[arrival.kind] = arrival.log_ns
        t.payload_bytes += len(arrival.payload)

    def flush(self) -> None:
        """See to it that everything so far is in the file, and that there is room for more."""
        self._file.flush()
        self._require_room()

    def close(self, losses: Mapping[str, int] | None = None) -> None:
        """Complete the last file; `losses` are told in its metadata."""
        if losses is not None:
            self._file.describe(LOSSES, {name: str(count) for name, count in losses.items()})
        self._file.close()

    def abandon(self) -> None:
        """Complete the last file as far as the disk lets one; never raises."""
        _try(self._file.flush)
        _try(self._file.close)

    def _admits(self, key: str) -> bool:
        if key not in self._keys and len(self._keys) < MAX_KEYS:
            self._keys.add(key)
        return key in self._keys

    def _check(self, arrival: Arrival) -> Message | None:
        """Decode, and count what is missing or not valid."""
        try:
            message = decode(arrival.payload)
            if type(message).__name__ != QOS[arrival.kind].message:
                raise DecodeError("schema", f"a {type(message).__name__} on {arrival.key}")
        except DecodeError as error:
            self.tally.invalid[error.reason] = self.tally.invalid.get(error.reason, 0) + 1
            return None
        self._count_lost(arrival.key, message)
        return message

    def _count_lost(self, key: str, message: Message) -> None:
        seq = getattr(message, "seq", None)
        lost = 0 if seq is None else self._sequences.sight(key, message.session, seq).lost
        if lost:
            self.tally.lost[key] = self.tally.lost.get(key, 0) + lost

    def _remember(self, arrival: Arrival, truth: TruthBatch) -> None:
        name = last_chunk(arrival.key)
        session, batches = self._truth.get(name, ("", []))
        if session != truth.session:
            session, batches = truth.session, []
        batches.append((arrival.payload, truth))
        self._truth[name] = (session, batches)

    def _is_full(self, log_ns: int) -> bool:
        o = self._options
        begun = self._begun_ns if self._begun_ns is not None else log_ns
        return (o.max_bytes is not None and self._file.size >= o.max_bytes) or (
            o.max_seconds is not None and log_ns - begun >= o.max_seconds * 1e9
        )

    def _rotate(self, log_ns: int) -> None:
        self._file.close()
        self._closed_bytes += self._file.path.stat().st_size
        self._begun_ns = log_ns
        self._file = self._next_file()
        truth_key = f"comotion/@v1/{self._options.scene}/truth"
        for name, (_, batches) in self._truth.items():
            for payload, truth in batches:
                self._file.add(f"{truth_key}/{name}", log_ns, payload, truth)

    def _next_file(self) -> RecordingFile:
        o, number = self._options, len(self.paths) + 1
        several = o.max_bytes is not None or o.max_seconds is not None
        path = o.path.with_name(f"{o.path.stem}-{number:03d}{o.path.suffix}") if several else o.path
        self.paths.append(path)
        return RecordingFile(path, scene=o.scene, number=number)

    def _require_room(self) -> None:
        folder = self._options.path.parent
        size = self._file.size if self.paths else 0
        needed = self._options.reserve_bytes + round(_INDEX_SHARE * size)
        if (free := free_bytes(folder)) < needed:
            raise StorageError(
                f"{folder}: only {free / 2**20:.0f} MiB free, {needed / 2**20:.0f} MiB are to stay free"
            )


def _try(action: Callable[[], None]) -> None:
    try:
        action()
    except OSError:
        return
