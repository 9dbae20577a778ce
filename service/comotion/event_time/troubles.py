"""Remembers what sources do wrong, for as long as their data shows it."""

from typing import Any

from comotion_schemas.messages import ProblemKind

# ns after which what was seen last is not reported any more, and the sources of a kind that are remembered.
_LASTS_NS, _MOST = 3_000_000_000, 256


class Troubles:
    """By kind, the sources, what shows it, and when it was seen last.

    `at_ns` is now, on the clock of arrivals.
    """

    def __init__(self) -> None:
        self.at_ns = 0
        self._seen: dict[ProblemKind, dict[str, tuple[int, Any]]] = {}

    def note(self, kind: ProblemKind, source: str, evidence: Any = None) -> None:
        """Take note of one; of too many sources, the one seen longest ago is forgotten."""
        seen = self._seen.setdefault(kind, {})
        seen.pop(source, None)
        if len(seen) >= _MOST:
            del seen[next(iter(seen))]
        seen[source] = self.at_ns, evidence

    def lately(self) -> dict[ProblemKind, dict[str, Any]]:
        """What has been seen within 3 s: by kind and source, the evidence."""
        since_ns = self.at_ns - _LASTS_NS
        return {
            kind: {name: one for name, (seen_ns, one) in sorted(seen.items()) if seen_ns >= since_ns}
            for kind, seen in self._seen.items()
        }
