"""One space: stores its released instants, and groups its trajectories at each update."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import Ids, Slots, distinct
from .config import FusionConfig, to_ns
from .event_time.entries import Instants
from .event_time.timeline import Timeline
from .hypotheses.drift import DriftCheck
from .hypotheses.identity import IdAllocator
from .hypotheses.registry import Registry
from .moving_frame import MovingFrame
from .partition import NO_HYPOTHESIS, Method, Partition, Previous, SpaceSpec
from .pixels.method import PixelMethod
from .rigid.method import RigidMethod
from .sampling import extended, representatives
from .saving import plain, refill
from .shedding import FULL, Effort
from .source_checks import ExtentCheck, SourceChecks
from .space_update import TRACK, SpaceUpdate, explained
from .tracks import Tracks
from .trajectories.window import Window

REFUSED = "rows are refused: more trajectories than `max_tracks`, or an id in two spaces"
"""Text where rows are beyond a bound."""


class Space:
    """Trajectories of one space and the method that groups them.

    States in different spaces are not comparable, so spaces share nothing but the id allocator.

    `last` is the last update, None before any; `owner` the source that was the first to observe something
    here, empty where that is not known; `fed_ns` when something came in last, on the clock of arrivals.
    """

    def __init__(self, config: FusionConfig, spec: SpaceSpec, ids: IdAllocator, timeline: Timeline) -> None:
        self.spec = spec
        self._stats, self._troubles = stats, troubles = timeline.stats, timeline.troubles
        self._window = Window(spec.dim, to_ns(config.window), to_ns(config.track_timeout))
        method = self._method = make_method(config, spec)
        self.tracks = Tracks(self._window, method, stats, timeline.track_timeout_ns)
        self._hypotheses = Registry(config.hypotheses, spec.name, ids, method.by_thesis)
        # Session numbers and ids of the trajectories that were grouped last.
        self._grouped: tuple[Slots, Ids] = np.zeros(0, np.intp), np.zeros(0, np.uint64)
        self.last: SpaceUpdate | None = None
        self.owner, self.fed_ns = "", 0
        self.extent = ExtentCheck(spec.unit, config.limits.extent, troubles)
        self.checks = SourceChecks(troubles)
        self.drift = DriftCheck()
        self._groupings = 0
        declared = config.spaces.get(spec.name)
        self.frame = MovingFrame(spec.dim, spec.unit == "m", None if declared is None else declared.moving)

    def store(self, instants: Instants, allowance: Callable[[int], int]) -> bool:
        """Put released rows into the window, in event-time order; False if all are too far out.

        `allowance` says how many of so many new trajectories may be opened: the rows of others are refused.
        """
        session, batch, stats = instants.session, instants.batch, self._stats
        near = self.extent.near(session, batch.source, instants.positions)
        kept, fresh, ended = instants.of(near), 0, 0
        stats.refused_rows += len(near) - len(kept.rows)
        in_scene = len(kept.rows) > 0 or not len(near)
        if in_scene:
            refused = stats.refused_rows
            fresh, ended = self.tracks.store(kept, allowance)
            self.frame.declared[session] = batch.source, bool(batch.moving)
            if stats.refused_rows - refused > ended:
                self._troubles.note("limit", batch.source, REFUSED)
        self.checks.look(instants, fresh, ended)
        return in_scene

    @property
    def size(self) -> int:
        """Trajectories of the last grouping."""
        return len(self._grouped[0])

    def update(self, stamp_ns: int, effort: Effort = FULL) -> SpaceUpdate:
        """Move the window to the watermark and group what is current, as far as `effort` says."""
        window, registry = self._window, self._hypotheses
        current = self.tracks.follow(stamp_ns)
        tracks = np.zeros(len(current), TRACK)
        for name, column in (("key", window.key), ("session", window.source), ("id", window.id)):
            tracks[name] = column[current]
        tracks["position"] = np.nan
        tracks["position"][:, : window.dim] = newest = window.newest(current)
        self.frame.follow(distinct(tracks["session"])[0].tolist(), self.tracks.sessions())
        self.extent.look(tracks["session"], newest)
        partition = self._partition(stamp_ns, effort)
        labels, hypotheses, events = registry.update(window, partition, current, stamp_ns, boxes=effort.boxes)
        # Links and joints follow from motion in the frame; what is published is relative to the world.
        bodies = [h for h in hypotheses if not h.absent]
        hypotheses, frame = self.frame.relative(stamp_ns, hypotheses, labels, partition.position)
        observed_s = (window.last_ns[current] - window.times[current, window.start[current]]) / 1e9
        tracks["label"] = labels
        tracks["confidence"] = partition.confidence * explained(tracks, bodies, observed_s)
        references = {number: record.reference for number, record in registry.records.items()}
        motions = partial(self._method.motions, registry.ids, references)
        self.last = SpaceUpdate(
            self.spec, window, current, tracks, hypotheses, bodies, motions, events, frame
        )
        return self.last

    def _partition(self, stamp_ns: int, effort: Effort) -> Partition:
        """Group the current trajectories, or some of them; the others keep their groups."""
        window, current = self._window, self.tracks.current
        self._method.searching = self._groupings % effort.search_every == 0
        self._groupings += 1
        self.drift.look(window, current, stamp_ns, self._method.delays_ns)
        steady = window.used.copy()
        for number in self.drift.drifting:
            steady &= window.source != number
        grouped = representatives(window, current[steady[current]], effort.share)
        view = window
        if len(grouped) < len(current):
            sampled = len(grouped) < np.count_nonzero(steady[current])
            view = window.of(grouped if sampled else np.flatnonzero(steady))
        partition = self._method.partition(
            view, grouped, stamp_ns, Previous(window.label, self._hypotheses.ids)
        )
        self._grouped = window.source[grouped], window.id[grouped]
        if len(grouped) == len(current):
            return partition
        return extended(window, partition, grouped, current)

    def forget(self, hypothesis: int | None) -> list[int]:
        """Forget a hypothesis, or all; returns those forgotten."""
        return self._hypotheses.forget(self._window, hypothesis)

    def affinity(self) -> tuple[Slots, Ids, NDArray[np.float32]]:
        """Session numbers intp [n], ids uint64 [n] and affinities float32 [n, n] of the last grouping."""
        return *self._grouped, self._method.affinity() if self._groupings else np.zeros((0, 0), np.float32)

    def state(self) -> dict[str, Any]:
        """The window, the method and the labels, as plain values and arrays."""
        return {
            "name": self.spec.name,
            "unit": self.spec.unit,
            "dim": self.spec.dim,
            "tracks": self.tracks.state(),
            "method": self._method.state(),
            "hypotheses": plain(self._hypotheses),
            "frame": plain(self.frame),
        }

    def load(self, state: dict[str, Any], *, keep_method: bool) -> None:
        """Take up :meth:`state`; without `keep_method` the trajectories alone."""
        self.tracks.load(state["tracks"])
        self._method.load(state["method"] if keep_method else {}, self._window)
        if keep_method:
            refill(self._hypotheses, state["hypotheses"])
            refill(self.frame, state["frame"])
        else:
            self._window.label[:] = self._window.established[:] = NO_HYPOTHESIS
            self.frame.moving = state["frame"]["moving"]


def make_method(config: FusionConfig, spec: SpaceSpec) -> Method:
    """Build the method of `config.method` for one space."""
    # Pixels with a third coordinate (a disparity) are no image plane: rigid motion is the better model.
    if config.method == "comotion" and spec.unit == "px" and spec.dim == 2:
        return PixelMethod()
    if config.method == "comotion":
        return RigidMethod(config, spec)
    # Its clustering imports scikit-learn, which takes half a second that the others do not need.
    from .thesis.method import ThesisMethod  # noqa: PLC0415

    return ThesisMethod(config, spec)
