"""The recorder process: records a scene to files until it is stopped or the disk is full."""

import logging
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Unpack, cast

import zenoh

from comotion_schemas import QOS, Keys
from comotion_schemas.component import Component, Rates, StatusFields, Where
from comotion_schemas.errors import KnownError
from comotion_schemas.inbox import Inbox
from comotion_schemas.keys import Kind
from comotion_schemas.message_log import Logged
from comotion_schemas.messages import RejectionReason
from comotion_schemas.terminal import reporting
from comotion_schemas.text import counted
from comotion_schemas.transport import Receiver

from .file import StorageError
from .series import Series, SeriesOptions

MAX_PENDING_BYTES = 256 * 1024 * 1024
# Truth arrives as a burst, since publishers cache it for late joiners; previews are large.
_RING_SAMPLES: dict[Kind, int] = {"truth": 65536, "preview": 64}
_DEFAULT_RING_SAMPLES = 8192


class PendingPayloads(Inbox[Logged]):
    """Payloads between the receiving threads and the writing thread, up to `limit` bytes.

    Those that are dropped because the disk is too slow are counted by key in :attr:`dropped_of`.
    """

    def __init__(self, limit: int = MAX_PENDING_BYTES) -> None:
        self.dropped_of: Counter[str] = Counter()
        super().__init__(limit, lambda a: len(a.payload), lambda a: self.dropped_of.update([a.key]))


@contextmanager
def receiving(session: zenoh.Session, keys: Keys, pending: PendingPayloads) -> Iterator[None]:
    """Put all kinds of messages of a scene into a queue, until the context ends."""

    def put(kind: Kind, key: str, payload: bytes) -> None:
        pending.put(Logged(kind, key, time.time_ns(), payload))

    with ExitStack() as stack:
        for kind in QOS:
            size = _RING_SAMPLES.get(kind, _DEFAULT_RING_SAMPLES)
            receiver = Receiver(session, keys.messages(kind), kind, size, partial(put, kind))
            stack.callback(receiver.close)
        yield


FLUSH_S = 1.0
"""Interval of writing to the disk: a crash loses at most the messages of this time."""
ROUTER_TIMEOUT_S = 10.0
"""Longest wait of a recording of limited duration for a router."""
_STEP_S = 0.1
_TERMINAL_LINE_S, _PLAIN_LINE_S = 0.25, 5.0  # between two lines of progress
_log = logging.getLogger(__name__)


@dataclass
class Result:
    """Result of a recording.

    `messages` by kind; `lost` (sequence gaps) and `dropped` (slow disk) by key; `invalid` by reason.
    """

    files: list[str]
    seconds: float
    messages: dict[str, int]
    bytes: int
    lost: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    invalid: dict[str, int] = field(default_factory=dict)

    def lines(self) -> list[str]:
        """Format the result as text."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(self.messages.items())) or "nothing"
        where = self.files[0] if len(self.files) == 1 else f"{len(self.files)} files, {self.files[0]} ..."
        lines = [f"{where}: {self.bytes / 2**20:.2f} MiB, {self.seconds:.1f} s: {kinds}"]
        lines += [f"lost: {n} of {key}" for key, n in sorted(self.lost.items())]
        lines += [
            f"dropped because the disk was too slow: {n} of {k}" for k, n in sorted(self.dropped.items())
        ]
        lines += [
            f"recorded although invalid: {n} {reason}"
            for reason, n in sorted(self.invalid.items())
            if reason != "limit"
        ]
        if "limit" in self.invalid:
            lines.append(f"not recorded, too many keys: {self.invalid['limit']}")
        return lines


class _Recorder(Series):
    """Writes pending payloads to the files and flushes them to the disk every second."""

    def __init__(self, options: SeriesOptions) -> None:
        super().__init__(options)
        self.pending = PendingPayloads()
        self.begun = time.monotonic()
        self._flush_at = self.begun + FLUSH_S
        self._reported_losses = 0
        self._rates = Rates()

    def step(self, timeout: float) -> None:
        """Write the pending payloads, waiting up to `timeout` s for the first."""
        self.pending.wait(timeout)
        for arrival in self.pending.drain():
            self.add(arrival)
        if time.monotonic() >= self._flush_at:
            self.flush()
            self._flush_at = time.monotonic() + FLUSH_S
            lost = self.lost.total()
            if lost > self._reported_losses:
                _log.warning("%s, %d so far", counted(lost - self._reported_losses, "lost message"), lost)
            self._reported_losses = lost

    def losses(self) -> dict[str, int]:
        """Total numbers of lost and dropped messages."""
        return {"lost": self.lost.total(), "dropped": self.pending.dropped}

    def status(self) -> StatusFields:
        """Build the Status of the recorder."""
        losses, wall = self.losses(), time.time_ns()
        return StatusFields(
            state="degraded" if losses["lost"] or losses["dropped"] else "ok",
            rates=self._rates.of({**self.messages}),
            ages={kind: max(0.0, (wall - at) / 1e9) for kind, at in self.newest.items()},
            counters={
                "messages": self.messages.total(),
                "bytes": self.file_bytes,
                "files": len(self.paths),
                **losses,
            },
            rejected=cast("dict[RejectionReason, int]", dict(self.invalid)),
            message=f"records into {self.path.name}",
        )

    def line(self) -> str:
        """Format the progress as one line."""
        seconds, lost = time.monotonic() - self.begun, self.lost.total()
        losses = f", {lost} lost" if lost else ""
        return (
            f"{self.path.name}: {seconds:.0f} s, {counted(self.messages.total(), 'message')}, "
            f"{self.file_bytes / 2**20:.2f} MiB{losses}"
        )

    def result(self) -> Result:
        """Summarise the recording so far."""
        return Result(
            files=[str(path) for path in self.paths],
            seconds=time.monotonic() - self.begun,
            messages={**self.messages},
            bytes=sum(path.stat().st_size for path in self.paths),
            lost=dict(self.lost),
            dropped=dict(self.pending.dropped_of),
            invalid=dict(self.invalid),
        )

    def remove_files_of_nothing(self) -> bool:
        """Remove the files if nothing was received; its own Status is a message of the scene too."""
        if any(count for kind, count in self.messages.items() if kind != "status"):
            return False
        for path in self.paths:
            path.unlink(missing_ok=True)
        return True


def record(
    options: SeriesOptions, name: str = "recorder", duration: float | None = None, **where: Unpack[Where]
) -> Result:
    """Record a scene until the duration is over or a signal arrives.

    `options` are of the files, with the scene in their metadata, `name` is that of the recorder, `duration`
    is in s, None: until stopped.

    Raises
    ------
    ValueError
        If nothing was received.
    OSError
        If a file exists or cannot be created.
    TimeoutError
        With a duration, if no router answers.
    StorageError
        If the disk is full; the files are intact.
    """
    recorder = _Recorder(options)
    timeout = None if duration is None else ROUTER_TIMEOUT_S
    recording = partial(Component, role="recorder", status=recorder.status, connect_timeout=timeout)
    progress = reporting(terminal_s=_TERMINAL_LINE_S, plain_s=_PLAIN_LINE_S)
    try:
        with recording(name=name, **where) as component:
            with receiving(component.session, component.keys, recorder.pending), progress as report:
                recorder.begun = time.monotonic()
                end = float("inf") if duration is None else recorder.begun + duration
                component.ready()
                while not component.stop.is_set() and (left := end - time.monotonic()) > 0:
                    recorder.step(min(_STEP_S, left))
                    report(recorder.line)
            recorder.step(0.0)
        recorder.close(recorder.losses())
    except StorageError as error:
        recorder.abandon()
        raise StorageError(f"the recording has stopped: {error}") from None
    except BaseException:
        recorder.abandon()
        recorder.remove_files_of_nothing()
        raise
    if recorder.remove_files_of_nothing():
        raise KnownError(f"no message was received in scene {options.scene!r}: nothing was recorded")
    return recorder.result()
