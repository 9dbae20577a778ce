"""Options of a camera source: of its tracker, and of which frames are due when, with which stamps."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ..calibration.files import Calibration
from ..markers import MarkerOptions
from ..schedule import Stamps
from .config import TrackerConfig

LATE_NS = 200_000_000
"""A frame of a recording that is late by more is left out."""

CLOCK_STEP_NS = 1_000_000_000
"""If a device's stamp goes back by more than this, its clock was set back."""

_COUNTERS = ("late", "duplicates", "thinned", "overruns", "slips", "clock_steps")
MAX_SKIPPED = 5
"""Most consecutive frames left out to catch up; then the recording is played more slowly instead."""


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Options of a camera source."""

    name: str = "klt"  # name of the source; its markers are the separate source ``<name>-markers``
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    # Play recordings at their recorded rate, or slower if the machine cannot; False: as fast as they can be
    # tracked, with every frame.
    realtime: bool = True
    # Of recordings: ``now``, as if taken while played, or ``original``, those of the file (media time from 0
    # if it has none).
    stamps: Stamps = "now"
    rate: float | None = None  # most frames per second; None: all
    offset_ns: int = 0  # added to every stamp, for a device with a known clock offset
    # Takes precedence over the calibration that the camera reports.
    calibration: Calibration = field(default_factory=Calibration)
    use_depth: bool = True  # False: publish pixels although there is depth
    space: str | None = None  # name of the space; None: see :func:`choose_space`
    fixed: bool = False  # require extrinsics for publishing metres
    loop: bool = False  # repeat a recording from its start
    reconnect: bool = True  # reopen a device that is lost
    preview: Path | None = None  # path of an annotated video, or a folder for PNG images; None: none
    share_preview: float = 5.0  # most images per second that subscribers get; 0: none
    markers: MarkerOptions | None = None  # fiducial markers to detect; None: none
    # A trajectory file with the pose of every frame, or source and id of the 6-DoF feature that carries the
    # camera; the extrinsics then lead from the camera to what these are poses of.
    poses: Path | None = None
    carrier: tuple[str, int] | None = None

    @property
    def posed(self) -> bool:
        """Whether the pose of every frame is known."""
        return self.poses is not None or self.carrier is not None


@dataclass
class Pacer:
    """Decides for each frame when it is due, or that it is left out."""

    options: CameraOptions  # of the user: which frames are published, when, and with which stamps
    live: bool  # whether the camera is a device: its frames are due on arrival and keep their stamps
    wait: Callable[[float], object]  # waits for a number of seconds
    # Clocks, in nanoseconds.
    wall: Callable[[], int] = time.time_ns
    monotonic: Callable[[], int] = time.monotonic_ns
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_COUNTERS, 0))
    _last_ns: int | None = None
    _next_ns: int | None = None
    _first_ns: int | None = None
    _pass_first_ns: int | None = None
    _elapsed_ns: int = 0
    _start_wall_ns: int = 0
    _start_ns: int = 0
    _missed: int = 0

    def admit(self, stamp_ns: int) -> int | None:
        """Wait until a frame is due and return its published stamp; None if it is left out.

        A frame that is not newer than the one before cannot be tracked and is left out.
        """
        if self.live and self._last_ns is not None and stamp_ns < self._last_ns - CLOCK_STEP_NS:
            # The clock of the device was set back: waiting for the old stamps could last for ever.
            self.counters["clock_steps"] += 1
            self._last_ns = self._next_ns = None
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self.counters["duplicates" if stamp_ns == self._last_ns else "late"] += 1
            return None
        self._last_ns = stamp_ns
        if self._thinned(stamp_ns):
            self.counters["thinned"] += 1
            return None
        published = stamp_ns if self.live else self._recorded(stamp_ns)
        return None if published is None else published + self.options.offset_ns

    def rewind(self, period_ns: int) -> None:
        """Start a new pass of the recording, one period after the last frame of this pass."""
        if self._last_ns is not None and self._pass_first_ns is not None:
            self._elapsed_ns += self._last_ns - self._pass_first_ns + period_ns
        self._last_ns = self._next_ns = self._pass_first_ns = None

    def _recorded(self, stamp_ns: int) -> int | None:
        if self._first_ns is None:
            self._first_ns, self._start_wall_ns, self._start_ns = stamp_ns, self.wall(), self.monotonic()
        if self._pass_first_ns is None:
            self._pass_first_ns = stamp_ns
        played = stamp_ns - self._pass_first_ns + self._elapsed_ns
        if self.options.realtime and not self._in_time(played):
            return None
        return played + (self._start_wall_ns if self.options.stamps == "now" else self._first_ns)

    def _in_time(self, played: int) -> bool:
        """Wait until a frame is due; False if it is left out."""
        early = self._start_ns + played - self.monotonic()
        if early >= -LATE_NS:
            self._missed = 0
            if early > 0:
                self.wait(early / 1e9)
            return True
        # Original stamps allow late playing; stamps of now require catching up.
        if self.options.stamps == "now" and self._missed < MAX_SKIPPED:
            self._missed += 1
            self.counters["overruns"] += 1
            return False
        self._missed = 0
        self.counters["slips"] += 1
        self._start_ns -= early
        self._start_wall_ns -= early
        return True

    def _thinned(self, stamp_ns: int) -> bool:
        if self.options.rate is None:
            return False
        period = 1e9 / self.options.rate
        # Tolerate jitter of a tenth of a period.
        if self._next_ns is not None and stamp_ns < self._next_ns - period / 10:
            return True
        due = stamp_ns if self._next_ns is None else self._next_ns
        self._next_ns = round(max(due + period, stamp_ns + period / 2))
        return False
