"""Scores the updates of a running scene against the truth that its sources publish."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, Unpack

import zenoh

from comotion_schemas import HypothesisUpdate, Joint, ObservationBatch, TruthBatch
from comotion_schemas.component import Where, viewer
from comotion_schemas.errors import KnownError
from comotion_schemas.plain import plain
from comotion_schemas.terminal import reporting
from comotion_schemas.text import counted

from .feed import BATCHES_KEPT, SceneFeed
from .joints import known_values
from .metrics import Score, Truth
from .scoring import Scoring, SpaceRef, Summary
from .watch_columns import number

POLL_S = 0.1
REPORT_S = 1.0
FIRST_UPDATE_TIMEOUT_S = 10.0
"""Least time that a run of limited duration waits for a router, and for its first update."""

OnUpdate: TypeAlias = Callable[[HypothesisUpdate, Score], None]


@dataclass(frozen=True)
class LiveRun:
    """Result of a live evaluation: scores, truth, spaces of the sources, lost and invalid updates.

    `joints` are those of the last update.
    """

    summary: Summary
    scores: list[Score]
    truth: Truth
    spaces: dict[str, SpaceRef]
    lost: int
    invalid: dict[str, int]
    joints: list[Joint]


class _Feed(SceneFeed):
    """Scores the updates of one scene."""

    def __init__(self, session: zenoh.Session, scene: str, on_update: OnUpdate) -> None:
        super().__init__(
            session, scene, {TruthBatch: None, ObservationBatch: BATCHES_KEPT, HypothesisUpdate: None}
        )
        self.scoring = Scoring()
        self.first_at: float | None = None
        self.joints: list[Joint] = []
        self._on_update = on_update

    def poll(self, now: float) -> None:
        """Process received messages and score the updates that are due at `now`."""
        for message, arrived, _ in self.messages():
            self.scoring.add(message, arrived)
            if self.first_at is None and isinstance(message, HypothesisUpdate):
                self.first_at = arrived
        for update in self.scoring.due(now):
            self.joints = update.joints
            self._on_update(update, self.scoring.score(update))


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

    Parameters
    ----------
    duration
        Seconds from the first update on; None: until stopped.
    quiet
        Show no progress.
    on_update
        Called with every scored update.
    where
        Name of the scene, how to connect, and the file to write once it is subscribed.

    Raises
    ------
    TimeoutError
        With a duration, if no router answers.
    ValueError
        If no update was received, or none could be scored because no source publishes truth.
    """
    timeout = None if duration is None else FIRST_UPDATE_TIMEOUT_S
    progress = reporting(quiet=quiet, terminal_s=REPORT_S, plain_s=REPORT_S)
    with (
        viewer("evaluate", connect_timeout=timeout, **where) as component,
        _Feed(component.session, component.scene, on_update) as feed,
        progress as report,
    ):
        if where.get("ready_file") is not None:
            component.ready()
        begun = time.monotonic()
        while not component.stop.wait(POLL_S) and not _is_over(feed, duration, begun):
            feed.poll(time.monotonic())
            report(lambda: progress_line(feed.scoring))
        feed.poll(math.inf)
    return _result(feed, component.scene)


def _is_over(feed: _Feed, duration: float | None, begun: float) -> bool:
    if duration is None:
        return False
    if feed.first_at is None:
        return time.monotonic() - begun >= max(duration, FIRST_UPDATE_TIMEOUT_S)
    return time.monotonic() - feed.first_at >= duration


def _result(feed: _Feed, scene: str) -> LiveRun:
    scoring = feed.scoring
    summary = scoring.summary()
    if not summary.updates:
        raise KnownError(f"no update was received in scene {scene!r}: is the service running?")
    if not summary.scored:
        raise KnownError(f"no update of scene {scene!r} could be scored: no source publishes truth")
    updates = feed.of[HypothesisUpdate].counters
    return LiveRun(
        summary=summary,
        scores=scoring.scores,
        truth=scoring.truth,
        spaces=dict(scoring.observed.spaces),
        lost=updates.lost,
        invalid=dict(updates.invalid),
        joints=feed.joints,
    )


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
    if run.lost or run.invalid:
        lines.append(f"{counted(run.lost, 'lost update')}, {sum(run.invalid.values())} invalid")
    return lines


def as_json(run: LiveRun) -> dict[str, Any]:
    """Convert the result to plain values for JSON, with NMI over time; unknown values are None."""
    values: dict[str, Any] = plain(run.summary) | {
        "lost": run.lost,
        "invalid": run.invalid,
        "joints": [known_values(joint) for joint in run.joints],
        "over_time": plain(run.scores),
    }
    return values
