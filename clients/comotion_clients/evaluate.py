"""Scores the updates of a running scene against the truth that its sources publish."""

import math
import time
from collections.abc import Callable
from typing import Any, TypeAlias, Unpack

from comotion_schemas import HypothesisUpdate, ObservationBatch, TruthBatch
from comotion_schemas.component import Where, viewer
from comotion_schemas.errors import KnownError
from comotion_schemas.plain import plain
from comotion_schemas.terminal import reporting
from comotion_schemas.text import counted

from .feed import SceneFeed
from .metrics import Score
from .scoring import Scoring
from .subscription import Counters
from .watch_columns import number

POLL_S = 0.1
REPORT_S = 1.0
FIRST_UPDATE_TIMEOUT_S = 20.0
"""Least time that a run of limited duration waits for a router, and for its first update with truth."""

_READ = (TruthBatch, ObservationBatch, HypothesisUpdate)
OnUpdate: TypeAlias = Callable[[HypothesisUpdate, Score], None]


class LiveRun(Scoring):
    """Scores of a running scene.

    Attributes
    ----------
    first_at
        When the first update with truth was scored, s of the monotonic clock.
    counters
        Of the subscription to updates: lost and invalid ones.
    """

    def __init__(self, on_update: OnUpdate) -> None:
        super().__init__()
        self.first_at: float | None = None
        self.counters = Counters()
        self._on_update = on_update

    def poll(self, feed: SceneFeed, now: float) -> None:
        """Process received messages and score the updates that are due at `now`."""
        for message, arrived, _ in feed.messages():
            self.add(message, arrived)
        for update in self.due(now):
            score = self.score(update)
            self._on_update(update, score)
            if self.first_at is None and score.scored:
                self.first_at = now
        self.counters = feed.of[HypothesisUpdate].counters


def evaluate(
    *,
    duration: float | None = None,
    quiet: bool = False,
    on_update: OnUpdate = lambda update, score: None,  # noqa: ARG005
    **where: Unpack[Where],
) -> LiveRun:
    """Score a running scene until the duration is over or a signal arrives.

    Every track that is observed at the stamp of an update is scored, whether the update lists it or
    not. Updates that repeat a stamp, because all sources have ended, are left out.

    `duration` is in s from the first update with truth on, None: until stopped; `quiet` shows no progress;
    `on_update` is called with every scored update.

    Raises
    ------
    TimeoutError
        With a duration, if no router answers.
    ValueError
        If no update was received, or none could be scored because no source publishes truth.
    """
    timeout = None if duration is None else FIRST_UPDATE_TIMEOUT_S
    run, progress = LiveRun(on_update), reporting(quiet=quiet, terminal_s=REPORT_S, plain_s=REPORT_S)
    with (
        viewer("evaluate", connect_timeout=timeout, **where) as component,
        SceneFeed(component.session, component.scene, _READ) as feed,
        progress as report,
    ):
        if where.get("ready_file") is not None:
            component.ready()
        end = math.inf if duration is None else time.monotonic() + max(duration, FIRST_UPDATE_TIMEOUT_S)
        while not component.stop.wait(POLL_S) and time.monotonic() < end:
            run.poll(feed, time.monotonic())
            if duration is not None and run.first_at is not None:
                end = run.first_at + duration
            report(lambda: progress_line(run))
        run.poll(feed, math.inf)
    if not run.scores:
        raise KnownError(f"no update was received in scene {component.scene!r}: is the service running?")
    if not any(score.scored for score in run.scores):
        raise KnownError(f"no update of scene {component.scene!r} could be scored: no source publishes truth")
    return run


def progress_line(scoring: Scoring) -> str:
    """Format the scores so far as one line."""
    if not scoring.scores:
        return "waiting for updates"
    score, updates, mean = scoring.scores[-1], len(scoring.scores), scoring.mean_nmi
    if math.isnan(mean):
        return f"{updates} updates, no truth yet"
    return (
        f"{updates} updates   NMI {number(score.nmi, 3)}   mean {number(mean, 3)}   "
        f"{score.hypotheses} hypotheses of {score.objects} objects   "
        f"{score.scored} tracks, {score.singletons} alone"
    )


def summary_lines(run: LiveRun) -> list[str]:
    """Format the result as text."""
    s = run.summary
    lines = [
        f"mean NMI {number(s.mean_nmi, 3)}, final {number(s.final_nmi, 3)}, over {s.scored} updates",
        f"error {number(100 * s.mean_misclassification, 1)} %, "
        f"{number(s.mean_hypotheses, 2)} hypotheses of {number(s.mean_objects, 2)} objects",
        f"{number(s.switches_per_100, 2)} label switches per 100 tracks and update",
        f"as tracked objects: HOTA {number(s.hota, 3)}, IDF1 {number(s.idf1, 3)}, "
        f"{number(s.id_switches, 0)} switches of identity",
    ]
    lost, invalid = run.counters.lost, run.counters.invalid.total()
    if lost or invalid:
        lines.append(f"{counted(lost, 'lost update')}, {invalid} invalid")
    return lines


def as_json(run: LiveRun) -> dict[str, Any]:
    """Convert the result to plain values for JSON, with NMI over time; unknown values are None."""
    values: dict[str, Any] = plain(run.summary) | {
        "lost": run.counters.lost,
        "invalid": run.counters.invalid,
        "joints": plain(run.last.joints, without_none=True),
        "over_time": plain(run.scores),
    }
    return values
