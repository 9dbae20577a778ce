"""Counters of what the fusion took in, dropped and refused. They only grow."""

from dataclasses import asdict, dataclass, field

from comotion_schemas import RejectionReason


@dataclass
class Stats:
    """The counters of Status (PROTOCOL.md).

    Batches are counted in `batches`, `late`, `reordered` and `duplicates`; rows in `observations`.
    A batch with rows on both sides of a limit counts once for each.
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
