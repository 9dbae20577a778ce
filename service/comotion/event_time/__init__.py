"""Event time: puts the batches of many sources in time order, and keeps their accounts.

Event time is one state machine, :class:`.timeline.Timeline`: what is found about a batch (:data:`Event`)
leads it from :class:`Stage` to stage, as :data:`TABLE` says. Both its clocks come from the caller: `now_ns`
is what stamps are compared with; `at_ns` is when something arrived, and must never be set. The rules are
those of docs/protocol.md, "Time"; the accounts are those of Status (:mod:`.stats`).

A batch comes in (`receive`):

1. Sequence numbers are followed per session. A skipped number is `lost` until it comes, a repeated batch is
   dropped.
2. A batch that the caller refuses is rejected, and so is one whose source has as many waiting as it may have.

The time is given (`advance`). Each batch that has come in since is judged, in the order of arrival:

3. One whose stamp is far from now may have to wait until it is clear whose clock is wrong (:mod:`.clocks`).
4. Rejected, and moves nothing: a stamp more than 1 s ahead of now (`future`); one older than the window
   while there is no watermark yet (`past`); one source too many (`limit`).
5. A source has one session at a time. Batches of another one wait; it takes over once the first has been
   silent for three of its periods, at least 0.2 s. As long as both send, the second is rejected
   (`duplicate-name`). What a session that is over sent before the next one started is `late`.
6. newest(s) is the largest stamp of source s.
7. Rows behind the watermark by at most `allowed_lateness` are `reordered`; older ones are dropped as `late`.
   What a late batch says about ended trajectories holds.

Then the watermark moves and releases:

8. W = max(previous W, now - `max_lag`, smallest newest(s) over live sources), never beyond now. A source is
   live while now - newest(s) <= `source_timeout`. Where none is live, those that still send count, since
   their clocks are behind; without any W stands still.
9. What is stamped <= W comes out in stamp order, ties by source name and then by arrival; newer data waits.
10. Right before the first instant of a new session comes out, the one before ends.
    Nothing of an ended session comes out any more: what still waits is dropped as `late`.
11. What a source's instants cost is charged to it; those that have sent for less than a second have one
    share together. One that has spent its share waits for its next one, and comes out behind the watermark
    then. After a second behind it, its batches there are dropped (`over-budget`). See :mod:`.budget`.

The following is forgotten:

12. A trajectory is outdated after `track_timeout` without observation, or 3 periods of its source if longer.
13. A session is forgotten when it is not its source's and has no trajectory left, and a source when it has
    been silent for `limits.expiry` (`forget_idle`). One source too many displaces the one silent for longest.
"""

from enum import Enum
from typing import Literal

from comotion_schemas import RejectionReason


class Stage(Enum):
    """A stage of a batch on its way; the last five are its end, by the name of its account."""

    ARRIVED = "arrived"
    CLOCK, NAME, WATERMARK = "clock", "name", "watermark"
    """It waits until it is clear whose clock is wrong, who has the name, and for the watermark."""
    FUSED, PARTLY_LATE, LATE, DUPLICATE, REJECTED = "fused", "partly_late", "late", "duplicates", "rejected"


Event = Literal["repeated", "far", "rival", "own", "late", "partly_late", "fused"] | RejectionReason
"""What is found about a batch, such as that it is far from now, or of a rival; why it is rejected, too."""

TABLE: dict[tuple[Stage, Event], Stage] = {
    (Stage.ARRIVED, "repeated"): Stage.DUPLICATE,  # rule 1
    (Stage.ARRIVED, "far"): Stage.CLOCK,  # 3
    (Stage.ARRIVED, "late"): Stage.LATE,  # 5
    (Stage.ARRIVED, "rival"): Stage.NAME,
    (Stage.ARRIVED, "own"): Stage.WATERMARK,
    (Stage.CLOCK, "repeated"): Stage.DUPLICATE,
    (Stage.CLOCK, "late"): Stage.LATE,
    (Stage.CLOCK, "rival"): Stage.NAME,
    (Stage.CLOCK, "own"): Stage.WATERMARK,
    (Stage.NAME, "own"): Stage.WATERMARK,
    (Stage.WATERMARK, "late"): Stage.LATE,  # 7 and 10
    (Stage.WATERMARK, "partly_late"): Stage.PARTLY_LATE,
    (Stage.WATERMARK, "fused"): Stage.FUSED,  # 9
}
"""The stage that follows; what is not in the table is a defect, and costs the batch."""
_REJECTED: dict[Stage, tuple[RejectionReason, ...]] = {
    Stage.ARRIVED: ("space-mismatch", "range", "limit", "future", "past", "defect"),  # 2 and 4
    Stage.CLOCK: ("limit", "future", "past", "defect"),
    Stage.NAME: ("duplicate-name", "defect"),  # 5
    Stage.WATERMARK: ("space-mismatch", "range", "limit", "over-budget", "defect"),  # 9 and 11
}
TABLE |= {(stage, why): Stage.REJECTED for stage, reasons in _REJECTED.items() for why in reasons}
