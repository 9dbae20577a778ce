"""A fusion in, its state in a file out, written atomically beside the loop; and back at the start."""

import logging
import os
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from ..config import FusionConfig
from ..event_time.timeline import FUTURE_NS
from ..fusion import Fusion

# Share of the time that the loop may spend on taking its state.
_SHARE = 0.05
_log = logging.getLogger(__name__)


def load_fusion(path: Path, config: FusionConfig, scene: str, session: str, now_ns: int | None) -> Fusion:
    """Continue from a state file, or start afresh with a warning when that is impossible.

    A file that cannot be used is kept as ``FILE.rejected``, never overwritten: it may belong to
    somebody else.

    Parameters
    ----------
    path
        The state file.
    config
        Parameters of the fusion.
    scene
        Name of the scene; a state of another scene is not used.
    session
        16 hex digits that name this run of the service.
    now_ns
        The wall clock in nanoseconds if the service follows it, else None. After a state from its
        future, every observation would be late.

    Raises
    ------
    OSError
        If the file is there but cannot be read or put aside.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Fusion(config, scene=scene, session=session)
    try:
        fusion = Fusion.restore(config, data, session=session)
        _require_match(fusion, scene, now_ns)
    except ValueError as error:
        aside = path.with_name(f"{path.name}.rejected")
        path.replace(aside)
        _log.warning("starting afresh: %s cannot be used (%s); kept as %s", path, error, aside.name)
        return Fusion(config, scene=scene, session=session)
    _log.info("continuing from %s", path)
    return fusion


def _require_match(fusion: Fusion, scene: str, now_ns: int | None) -> None:
    if fusion.scene != scene:
        raise ValueError(f"it is of scene {fusion.scene!r}, not {scene!r}")
    watermark = fusion.watermark_ns
    if now_ns is not None and watermark is not None and watermark > now_ns + FUTURE_NS:
        raise ValueError(f"it is from {(watermark - now_ns) / 1e9:.1f} s in the future")


def write_atomically(path: Path, data: bytes) -> None:
    """Replace a file in one step that survives a power cut.

    Raises
    ------
    OSError
        If the file cannot be written; the one before is still there.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with partial.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


class StateSchedule:
    """When to take the state: at an interval, and at once when the set of hypotheses has changed.

    A state that takes long is taken less often: it costs at most 5 % of the time.
    """

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._due_ns = 0
        self._allowed_ns = 0
        self._known: frozenset[int] = frozenset()

    def is_due(self, monotonic_ns: int, hypotheses: frozenset[int]) -> bool:
        """Whether to take it now."""
        if monotonic_ns < self._allowed_ns:
            return False
        return monotonic_ns >= self._due_ns or hypotheses != self._known

    def taken(self, monotonic_ns: int, took_ns: int, hypotheses: frozenset[int]) -> None:
        """Note that it has been taken, and for how long that has blocked the caller."""
        self._known = hypotheses
        self._allowed_ns = monotonic_ns + round(took_ns / _SHARE)
        self._due_ns = monotonic_ns + self._interval_ns


class StateWriter:
    """Writes the newest state from a thread, so that a slow disk never delays an update."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._wake = threading.Condition()
        self._data: bytes | None = None
        self._closing = False
        self.error: str = ""
        self._thread = threading.Thread(target=self._run, name="state", daemon=True)
        self._thread.start()

    def put(self, data: bytes) -> None:
        """Write this state soon; it replaces one that still waits."""
        with self._wake:
            self._data = data
            self._wake.notify()

    def close(self) -> None:
        """Write what still waits and end the thread."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._data is not None or self._closing)
                data, self._data = self._data, None
            if data is None:
                return
            self._write(data)

    def _write(self, data: bytes) -> None:
        try:
            write_atomically(self._path, data)
            self.error = ""
        except OSError as error:
            if not self.error:
                _log.warning("cannot write the state to %s: %s", self._path, error)
            self.error = f"state not written: {error.strerror}"


class StateKeeper:
    """Keeps the state of a running fusion in a file.

    As a context manager, it writes the last state on leaving, unless an exception is the reason.

    Parameters
    ----------
    path
        The state file; None: nothing is kept.
    interval_ns
        Time between two writes.
    fusion
        Whose state it is.
    """

    def __init__(self, path: Path | None, interval_ns: int, fusion: Fusion) -> None:
        self._fusion = fusion
        self._schedule = StateSchedule(interval_ns)
        self._writer = None if path is None else StateWriter(path)

    @property
    def error(self) -> str:
        """Why the last write failed; empty if it did not."""
        return "" if self._writer is None else self._writer.error

    def after(self, hypotheses: frozenset[int], monotonic_ns: int) -> None:
        """Take the state if it is due; `hypotheses` are the ids in the update just published."""
        if self._writer is not None and self._schedule.is_due(monotonic_ns, hypotheses):
            self._writer.put(self._fusion.snapshot())
            self._schedule.taken(monotonic_ns, time.monotonic_ns() - monotonic_ns, hypotheses)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is None:
            return
        if kind is None:
            self._writer.put(self._fusion.snapshot(clean=True))
        self._writer.close()
