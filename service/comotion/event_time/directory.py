"""The sources of a scene by name: which ones there are, send and agree, and which are forgotten."""

from collections.abc import Callable, Iterable
from typing import Any

from ..config import FusionConfig, to_ns
from .sources import Source, SourceHealth

# How long a name is said to be in double after the last batch of the second process.
_RIVALLED_NS = 3_000_000_000


class Sources(dict[str, Source]):
    """Sources by name.

    Parameters
    ----------
    config
        `source_timeout` and `limits` are used.
    """

    def __init__(self, config: FusionConfig) -> None:
        super().__init__()
        self._timeout_ns = to_ns(config.source_timeout)
        self._expiry_ns = to_ns(config.limits.expiry)

    def agreed_ns(self) -> int | None:
        """When a source has agreed with the time of the scene last, on the clock of arrivals."""
        return max((s.agreed_ns for s in self.values() if s.agreed_ns is not None), default=None)

    def any_agrees(self, at_ns: int) -> bool:
        """Whether any source has lately agreed with the time of the scene."""
        agreed = self.agreed_ns()
        return agreed is not None and at_ns - agreed <= self._timeout_ns

    def sending(self, at_ns: int) -> list[Source]:
        """Sources whose batches still come."""
        return [s for s in self.values() if s.is_sending(at_ns, self._timeout_ns)]

    def has_heard(self) -> bool:
        """Whether any source has been heard since the start."""
        return any(source.heard_ns is not None for source in self.values())

    def health(self, now_ns: int, at_ns: int) -> list[SourceHealth]:
        """Health of every source, by name."""
        return [
            SourceHealth(
                name,
                source.session,
                now_ns - source.newest_ns,
                source.period_ns,
                source.is_live(now_ns, self._timeout_ns),
                source.is_sending(at_ns, self._timeout_ns),
            )
            for name, source in sorted(self.items())
        ]

    def rivalled(self, at_ns: int) -> list[str]:
        """Names of which a second process has lately sent batches too."""
        return sorted(
            name
            for name, source in self.items()
            if source.rivalled_ns is not None and at_ns - source.rivalled_ns <= _RIVALLED_NS
        )

    def longest_silent(self, at_ns: int, waits: Callable[[str], bool]) -> str | None:
        """Name of the source that has been silent for longest, without those of which something waits."""
        silent = [
            (_idle_ns(source, at_ns), name)
            for name, source in self.items()
            if not source.is_sending(at_ns, self._timeout_ns) and not waits(name)
        ]
        return max(silent)[1] if silent else None

    def forget_silent(self, at_ns: int, in_use: Callable[[str, Source], bool]) -> None:
        """Forget the sources that have long been silent and are not in use."""
        for name, source in list(self.items()):
            if _idle_ns(source, at_ns) > self._expiry_ns and not in_use(name, source):
                del self[name]

    def state(self) -> list[Any]:
        """As plain values."""
        return [[name, source.state()] for name, source in self.items()]

    def load(self, state: Iterable[Any]) -> None:
        """Take up :meth:`state`."""
        self.update({name: Source.from_state(source) for name, source in state})


def _idle_ns(source: Source, at_ns: int) -> int:
    return 2**62 if source.heard_ns is None else at_ns - source.heard_ns
