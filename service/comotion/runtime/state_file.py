"""The state of the service in a file: written atomically beside the loop, restored at start."""

import logging
import os
import threading
from pathlib import Path

from ..config import FusionConfig
from ..fusion import Fusion

_AHEAD_NS = 1_000_000_000
_SHARE = 0.05
_log = logging.getLogger(__name__)


def load_fusion(path: Path, config: FusionConfig, scene: str, session: str, now_ns: int | None) -> Fusion:
    """Continue from a state file, or start afresh with a warning when that is impossible.

    A file that is there but of no use is kept as ``FILE.rejected``, never overwritten: it may not
    be ours.

    Parameters
    ----------
    now_ns
        The wall clock when the service follows it: a state from its future would call every
        observation late.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Fusion(config, scene=scene, session=session)
    try:
        fusion = Fusion.restore(config, data, session=session)
        _require_ours(fusion, scene, now_ns)
    except ValueError as error:
        aside = path.with_name(f"{path.name}.rejected")
        path.replace(aside)
        _log.warning("starting afresh: %s is of no use (%s); kept as %s", path, error, aside.name)
        return Fusion(config, scene=scene, session=session)
    _log.info("continuing from %s", path)
    return fusion


def _require_ours(fusion: Fusion, scene: str, now_ns: int | None) -> None:
    if fusion.scene != scene:
        raise ValueError(f"it is of scene {fusion.scene!r}, not {scene!r}")
    watermark = fusion.timeline.watermark_ns
    if now_ns is not None and watermark is not None and watermark > now_ns + _AHEAD_NS:
        raise ValueError(f"it is from {(watermark - now_ns) / 1e9:.1f} s in the future")


def write_atomically(path: Path, data: bytes) -> None:
    """Replace a file in one step that survives a power cut."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with partial.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


class StateSchedule:
    """When to take the state: at an interval, and at once when the set of hypotheses has changed.

    A state that is expensive to take is taken less often, at most for 5 % of the time.
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
        """Note that it has been taken, and how long that has held up the caller."""
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
        """Have this state written; one that still waits is superseded."""
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
