"""What can be said of every source at a given time."""

from dataclasses import dataclass

from .timeline import Timeline


@dataclass(frozen=True)
class SourceHealth:
    """One source: `age_ns` since its newest stamp, `period_ns` between its instants (0: unknown)."""

    name: str
    session: str
    age_ns: int
    period_ns: int
    live: bool


def source_health(timeline: Timeline, now_ns: int) -> list[SourceHealth]:
    """Health of every source seen so far, by name."""
    return [
        SourceHealth(
            name, clock.session, now_ns - clock.newest_ns, clock.period_ns, timeline.is_live(name, now_ns)
        )
        for name, clock in sorted(timeline.sources.items())
    ]
