"""Names hypotheses by the features that they hold, which sources have named. Pure."""

from collections import ChainMap

import numpy as np

from comotion_schemas import Hypothesis, HypothesisUpdate, Status
from comotion_schemas.naming import Names

_MOST_SOURCES = 256
# What does not move so soon after its birth is the background before that is known.
_YOUNG_NS = 2_000_000_000


class HypothesisNames(ChainMap[int, str]):
    """Name by id of a hypothesis: what a person gives, or else the name of a feature that it holds.

    A hypothesis keeps its name until another one holds that feature, and no two of a space have the same. Of
    several the last is taken: that of a robot's link which is farthest from its base. What rests from the
    start has none: a link that has not moved yet is there with all the background. A body in one space that
    is linked to a body with a name in another has that name. `given` are names that people give.
    """

    def __init__(self, given: Names | None = None) -> None:
        super().__init__(dict(given or {}), {}, {})
        self._of_features: dict[tuple[str, str], dict[int, str]] = {}

    def on_status(self, status: Status) -> None:
        """Add the Status of a component."""
        if not status.feature_names or len(self._of_features) >= _MOST_SOURCES:
            return
        names = {int(number): name for number, name in status.feature_names.items()}
        for key in [key for key in self._of_features if key[0] == status.component]:
            del self._of_features[key]
        self._of_features[status.component, status.session] = names

    def on_update(self, update: HypothesisUpdate) -> None:
        """Find the names of an update's hypotheses."""
        held: dict[int, list[str]] = {}
        for number, source in enumerate(update.sources):
            names = self._of_features.get((source.name, source.session), {})
            rows = np.flatnonzero(update.track_source == number) if names else ()
            for row in rows:
                if (name := names.get(int(update.track_id[row]))) is not None:
                    held.setdefault(int(update.track_hypothesis[row]), []).append(name)
        stands = {h.id for h in update.hypotheses if _stands(h, update.stamp_ns)}
        living = {h.id: held.get(h.id, []) for h in update.hypotheses if h.id not in stands}
        holders = {name: hypothesis for hypothesis, names_held in held.items() for name in names_held}
        kept = {
            hypothesis: name
            for hypothesis, name in self.maps[1].items()
            if hypothesis in living and holders.get(name, hypothesis) == hypothesis
        }
        for hypothesis, names_held in living.items():
            taken = set(kept.values())
            free = [name for name in names_held if name not in taken]
            if hypothesis not in kept and free:
                kept[hypothesis] = free[-1]
        self.maps[1:] = [kept, {}]
        links = [(h.id, link) for h in update.hypotheses for link in h.linked or () if link in self]
        self.maps[2] = {hypothesis: self[link] for hypothesis, link in links}


def _stands(hypothesis: Hypothesis, now_ns: int) -> bool:
    """Whether it is, or may be, all that rests."""
    young = now_ns - hypothesis.born_ns < _YOUNG_NS
    return hypothesis.state == "static" or (hypothesis.state == "undetermined" and young)
