"""What happens to batches, rows and updates in; the counters of Status out. They only grow."""

from dataclasses import asdict, dataclass, field

from comotion_schemas import RejectionReason


@dataclass
class Stats:
    """The counters of Status (docs/protocol.md).

    Attributes
    ----------
    batches
        Batches that came in, whatever became of them.
    observations
        Rows that were stored.
    lost
        Batches whose sequence number was skipped.
    late, reordered
        Batches with rows too old to be stored, and batches with rows stored behind the watermark; a batch
        with rows on both sides of the limit counts in both.
    duplicates
        Batches seen before, and instants with a row that was stored before.
    tracks, updates
        Trajectories opened, and updates computed.
    overruns
        Deadlines missed by the service.
    rejected
        Batches refused, by reason.
    """

    batches: int = 0
    observations: int = 0
    lost: int = 0
    late: int = 0
    reordered: int = 0
    duplicates: int = 0
    tracks: int = 0
    updates: int = 0
    overruns: int = 0
    rejected: dict[RejectionReason, int] = field(default_factory=dict)

    def reject(self, reason: RejectionReason, count: int = 1) -> None:
        """Count a rejection."""
        self.rejected[reason] = self.rejected.get(reason, 0) + count

    def counters(self) -> dict[str, int]:
        """The plain counters, without the rejections."""
        return {name: value for name, value in asdict(self).items() if isinstance(value, int)}
