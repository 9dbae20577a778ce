"""The recorder as a process: presence, progress, and a clean stop whatever happens."""

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from rich.console import Console
from rich.live import Live

from comotion_schemas import DEFAULT_SCENE
from comotion_schemas.component import Component, StatusFields
from comotion_schemas.messages import RejectionReason
from comotion_schemas.transport import SessionSettings

from .file import StorageError
from .intake import Intake, Waiting
from .series import Series, SeriesOptions

FLUSH_S = 1.0
"""A crash loses at most what came within this time."""
_TICK_S = 0.1
_LINE_EVERY_S = 5.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """What to record into, for how long, and under which name; `quiet`: no progress."""

    series: SeriesOptions
    name: str = "recorder"
    duration: float | None = None
    ready_file: Path | None = None
    quiet: bool = False


@dataclass
class Result:
    """What a recorder has to show for itself; `losses` by kind of loss."""

    files: list[str]
    seconds: float
    messages: dict[str, int]
    bytes: int
    lost: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    invalid: dict[str, int] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    def lines(self) -> list[str]:
        """The result in words."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(self.messages.items())) or "nothing"
        where = self.files[0] if len(self.files) == 1 else f"{len(self.files)} files, {self.files[0]} ..."
        lines = [f"{where}: {self.bytes / 2**20:.2f} MiB, {self.seconds:.1f} s: {kinds}"]
        lines += [f"lost on the way: {n} of {key}" for key, n in sorted(self.lost.items())]
        lines += [
            f"of these dropped here, the disk was too slow: {n} of {k}"
            for k, n in sorted(self.dropped.items())
        ]
        lines += [
            f"recorded although not valid: {n} {reason}"
            for reason, n in sorted(self.invalid.items())
            if reason != "limit"
        ]
        if "limit" in self.invalid:
            lines.append(f"not recorded, on one key too many: {self.invalid['limit']}")
        return lines


class _Recorder:
    """Moves what waits into the files, once in a while through to the disk."""

    def __init__(self, series: Series, waiting: Waiting) -> None:
        self.series, self.waiting = series, waiting
        self.begun = time.monotonic()
        self._flush_at = self.begun + FLUSH_S
        self._told = 0
        self._rates: tuple[float, dict[str, int], dict[str, float]] = (self.begun, {}, {})

    def step(self, timeout: float) -> None:
        """Write what has come, waiting for it up to `timeout` s."""
        for arrival in self.waiting.take(timeout):
            self.series.add(arrival)
        if time.monotonic() >= self._flush_at:
            self.series.flush()
            self._flush_at = time.monotonic() + FLUSH_S
            self._tell_losses()

    def losses(self) -> dict[str, int]:
        """Sums of what was lost."""
        return {
            "lost": sum(self.series.tally.lost.values()),
            "dropped": sum(self.waiting.dropped.values()),
        }

    def _tell_losses(self) -> None:
        lost = self.losses()["lost"]
        if lost > self._told:
            _log.warning("%d messages lost on the way, %d so far", lost - self._told, lost)
        self._told = lost

    def status(self) -> StatusFields:
        """What the recorder tells about itself, once a second."""
        tally, now = self.series.tally, time.monotonic()
        before, counts, _ = self._rates
        messages = {str(kind): count for kind, count in tally.messages.items()}
        seconds = max(now - before, 1e-3)
        rates = {kind: (count - counts.get(kind, 0)) / seconds for kind, count in messages.items()}
        self._rates = (now, messages, rates)
        wall = time.time_ns()
        losses = self.losses()
        return StatusFields(
            state="degraded" if losses["lost"] or losses["dropped"] else "ok",
            rates=rates,
            ages={str(kind): max(0.0, (wall - at) / 1e9) for kind, at in tally.newest.items()},
            counters={
                "messages": tally.total,
                "bytes": self.series.file_bytes,
                "files": len(self.series.paths),
                **losses,
            },
            rejected=cast("dict[RejectionReason, int]", dict(tally.invalid)),
            message=f"records into {self.series.path.name}",
        )

    def line(self) -> str:
        """How it stands, in one line."""
        tally, lost = self.series.tally, self.losses()["lost"]
        seconds = time.monotonic() - self.begun
        told = f", {lost} lost" if lost else ""
        return (
            f"{self.series.path.name}: {seconds:.0f} s, {tally.total} messages, "
            f"{self.series.file_bytes / 2**20:.2f} MiB{told}"
        )

    def result(self) -> Result:
        """Everything so far."""
        tally = self.series.tally
        return Result(
            files=[str(path) for path in self.series.paths],
            seconds=time.monotonic() - self.begun,
            messages={str(kind): count for kind, count in tally.messages.items()},
            bytes=sum(path.stat().st_size for path in self.series.paths),
            lost=dict(tally.lost),
            dropped=dict(self.waiting.dropped),
            invalid=dict(tally.invalid),
        )


def record(
    options: RecordOptions,
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
) -> Result:
    """Record a scene until told to stop.

    Parameters
    ----------
    options
        Where to and for how long.
    scene, settings
        What to record and where to connect.

    Raises
    ------
    ValueError
        If the scene or name is no valid name.
    OSError
        If a file exists or cannot be made.
    StorageError
        If the disk is full; the files are intact.
    """
    waiting = Waiting()
    series = Series(options.series)
    recorder = _Recorder(series, waiting)
    try:
        with Component(
            role="recorder",
            name=options.name,
            scene=scene,
            settings=settings,
            status=recorder.status,
            ready_file=options.ready_file,
        ) as component:
            with Intake(component.session, component.keys, waiting):
                recorder.begun = time.monotonic()
                component.ready()
                _run(recorder, component, options)
            recorder.step(0.0)
        series.close(recorder.losses())
    except StorageError as error:
        series.abandon()
        raise StorageError(f"the recording has stopped: {error}") from None
    except BaseException:
        series.abandon()
        raise
    return recorder.result()


def _run(recorder: _Recorder, component: Component, options: RecordOptions) -> None:
    end = float("inf") if options.duration is None else recorder.begun + options.duration
    with _reporting(options.quiet) as report:
        while not component.stop.is_set() and (left := end - time.monotonic()) > 0:
            recorder.step(min(_TICK_S, left))
            report(recorder)


@contextlib.contextmanager
def _reporting(quiet: bool) -> Iterator[Callable[[_Recorder], None]]:
    """Progress on standard error: one line that changes on a terminal, else a line now and then."""
    if quiet:
        yield lambda recorder: None  # noqa: ARG005
    elif sys.stderr.isatty():
        with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:
            yield _Every(0.25, live.update)
    else:
        yield _Every(_LINE_EVERY_S, lambda line: print(line, file=sys.stderr, flush=True))  # noqa: T201


class _Every:
    def __init__(self, seconds: float, show: Callable[[str], None]) -> None:
        self._seconds, self._show = seconds, show
        self._due = time.monotonic() + seconds

    def __call__(self, recorder: _Recorder) -> None:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + self._seconds
            self._show(recorder.line())
