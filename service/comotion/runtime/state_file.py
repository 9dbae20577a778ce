"""Restores a fusion from its state file, and writes that of a running fusion, in one step, beside the loop.

`FILE` holds the snapshot; `FILE.ids` holds an id that no hypothesis has had, for the day `FILE` is lost.
Both are replaced in one step and readable by their owner alone.
"""

import logging
import os
import re
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from comotion_schemas import UNDETERMINED
from comotion_schemas.errors import KnownError
from comotion_schemas.text import duration
from comotion_schemas.transport import DEFAULT_ENDPOINT

from ..config import FusionConfig
from ..event_time.clocks import FUTURE_NS
from ..fusion import Fusion
from ..saving import MAX_BYTES

_IDS = re.compile(rb"comotion-ids (\d{1,10})\n")
_IDS_BYTES = 64
# Ids reserved at once in the second file: it is written that rarely.
_RESERVED = 1000
# With a scene's and a replica's 64 each and the endings, a name stays below the 255 of file systems.
_NETWORK_CHARACTERS = 80
# Share of the time for taking and writing states: the thread keeps the loop from the interpreter meanwhile.
_SHARE = 0.1
_log = logging.getLogger(__name__)


def default_path(scene: str, endpoints: Iterable[str]) -> Path:
    """Where the state of a scene, or of a replica of it, is kept unless an option says otherwise.

    Scenes of the same name in different networks are different scenes: the endpoints count unless they are
    the default ones.
    """
    root = os.environ.get("XDG_STATE_HOME", "")
    # The specification of base directories has relative paths ignored.
    folder = Path(root) if Path(root).is_absolute() else Path.home() / ".local" / "state"
    networks = sorted(
        {re.sub(r"[^A-Za-z0-9.-]+", "-", endpoint) for endpoint in endpoints if endpoint != DEFAULT_ENDPOINT}
    )
    network = "".join(f"@{endpoint}" for endpoint in networks)[:_NETWORK_CHARACTERS]
    return folder / "comotion" / f"{scene}{network}.state"


def load_fusion(path: Path, config: FusionConfig, scene: str, session: str, now_ns: int | None) -> Fusion:
    """Continue from a state file, or start afresh with a warning when that is impossible.

    A file that cannot be used is kept as ``FILE.rejected``: it may be of another scene or version. Hypothesis
    ids continue after those given out before, as far as ``FILE.ids`` tells.

    A state of another scene is not used, nor one from the future of `now_ns`, the wall clock in nanoseconds
    if the service follows it: every observation would be late.
    """
    first_id = _reserved(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        fusion = _continued(data, config, scene, session, now_ns)
    except FileNotFoundError:
        pass
    except (ValueError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        _log.warning("starting afresh: %s cannot be used (%s)%s", path, reason, _put_aside(path))
    else:
        _log.info("continuing the scene of %s, %s", _age(path), path)
        return fusion
    return Fusion(config, scene=scene, session=session, first_id=first_id)


def begin_afresh(path: Path) -> None:
    """Let a new scene take the place of a kept one, which stays beside it as ``FILE.before``; logs that."""
    with suppress(OSError):  # there is none, or the error is reported when the state is written
        age, backup = _age(path), _beside(path, "before")
        path.replace(backup)
        _log.info("a new scene; the one of %s is kept: --state %s continues it", age, backup)


def _age(path: Path) -> str:
    """How long ago a file was written, in words."""
    return f"{duration(max(time.time() - path.stat().st_mtime, 0.0))} ago"


def _continued(data: bytes, config: FusionConfig, scene: str, session: str, now_ns: int | None) -> Fusion:
    """A fusion that goes on from a snapshot; a twin has tried it out. ValueError where that is impossible."""
    if len(data) > MAX_BYTES:
        raise KnownError(f"a snapshot has at most {MAX_BYTES} bytes")
    twin, fusion = Fusion.restore(config, data), Fusion.restore(config, data, session=session)
    watermark = fusion.timeline.watermark_ns
    with twin.timeline.faults.guard("trying a state out") as failed:
        update = twin.update(watermark or 0)
        twin.snapshot()
    if failed:
        raise KnownError(f"no update follows from it: {type(failed[0]).__name__} {failed[0]}")
    if update.scene != scene:
        raise KnownError(f"it is of scene {update.scene!r}, not {scene!r}")
    if now_ns is not None and watermark is not None and watermark > now_ns + FUTURE_NS:
        raise KnownError(f"it is from {(watermark - now_ns) / 1e9:.1f} s in the future")
    return fusion


def _put_aside(path: Path) -> str:
    aside = _beside(path, "rejected")
    try:
        path.replace(aside)
    except OSError as error:
        return f"; nor can it be put aside: {error.strerror}"
    return f"; kept as {aside.name}"


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(f"{path.name}.{ending}")


def _reserved(path: Path) -> int:
    """The id that ``FILE.ids`` holds; 1 without such a file."""
    try:
        with _beside(path, "ids").open("rb") as file:
            match = _IDS.fullmatch(file.read(_IDS_BYTES))
    except OSError:
        return 1
    if match is None or not 0 < int(match[1]) < UNDETERMINED:
        _log.warning("%s is damaged", _beside(path, "ids"))
        return 1
    return int(match[1])


def write_atomically(path: Path, parts: Iterable[Any]) -> None:
    """Replace a file in one step that survives a power cut; only its owner can read it.

    `parts` are buffers, written one after the other. The folder is made where it is missing. Raises OSError
    if the file cannot be written; the one before is still there.
    """
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    partial = path.with_name(f".{path.name}.partial")
    try:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
        with open(descriptor, "wb") as file:  # noqa: PTH123 - of a descriptor
            file.writelines(parts)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    # Without this the name may still mean the file before after a power cut.
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_ids(path: Path, following: int) -> int:
    """Write in ``FILE.ids`` that ids below one beyond `following` may be given out; returns that one."""
    reserved = min(following + _RESERVED, UNDETERMINED - 1)
    write_atomically(_beside(path, "ids"), [b"comotion-ids %d\n" % reserved])
    return reserved


class StateKeeper:
    """Keeps the state of a running fusion in a file; a context manager.

    The state is taken at an interval, and at once when the set of hypotheses has changed; one that takes long
    less often, so that it costs at most a tenth of the time. A thread serialises and writes the newest one.
    On leaving the last state is written, unless an exception is the reason.
    `error` is why the last write failed; empty if it did not.
    """

    def __init__(self, path: Path, interval_ns: int, fusion: Fusion) -> None:
        self._path = path
        self._interval_ns = interval_ns
        self._fusion = fusion
        self.error = ""
        self._due_ns = self._allowed_ns = self._writing_ns = 0
        self._saved: frozenset[int] = frozenset()
        self._reserved = 0
        self._writer = ThreadPoolExecutor(1, "state")
        self._newest: Future[None] = Future()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *others: object) -> None:
        if kind is None:
            self._take(clean=True)
        self._writer.shutdown()

    def after(self, hypotheses: frozenset[int], monotonic_ns: int) -> None:
        """Take the state if it is due; `hypotheses` are the ids in the update just published."""
        changed = hypotheses != self._saved
        if monotonic_ns < self._allowed_ns or not (changed or monotonic_ns >= self._due_ns):
            return
        self._take()
        self._saved = hypotheses
        cost_ns = time.monotonic_ns() - monotonic_ns + self._writing_ns
        self._allowed_ns = monotonic_ns + round(cost_ns / _SHARE)
        self._due_ns = monotonic_ns + self._interval_ns

    def _take(self, *, clean: bool = False) -> None:
        # In the place of one that still waits.
        self._newest.cancel()
        self._newest = self._writer.submit(
            self._write, self._fusion.next_id, self._fusion.capture(clean=clean)
        )

    def _write(self, next_id: int, pieces: Callable[[], list[Any]]) -> None:
        began = time.thread_time_ns()
        try:
            if next_id >= self._reserved:
                self._reserved = write_ids(self._path, next_id)
            write_atomically(self._path, pieces())
            self.error = ""
        # In a thread of its own: what is raised here nobody would see, and the next state may be written.
        except Exception as error:
            reason = error.strerror if isinstance(error, OSError) else repr(error)
            if not self.error:
                _log.warning("cannot write the state to %s: %s", self._path, reason)
            self.error = f"state not written: {reason}"
        self._writing_ns = time.thread_time_ns() - began
