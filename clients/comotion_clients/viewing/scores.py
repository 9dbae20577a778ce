"""Score curves: updates and truth -> NMI and misclassification over time, per space. Pure."""

from comotion_schemas import HypothesisUpdate
from comotion_schemas.colours import HUES

from ..metrics import TrackIds, Truth, score_update
from ..scoring import Observed
from .drawing import Moment, Shape, value
from .paths import Paths


class ScoreCurves:
    """Scores updates; `scored`: whether any update could be scored."""

    def __init__(self) -> None:
        self.scored = False
        self.truth = Truth()
        self._spaces: list[str] = []
        self._paths = Paths("scores")

    def draw(self, update: HypothesisUpdate, observed: Observed) -> list[Moment]:
        """Return the scores of an update as shapes; none without truth. Updates must come in order."""
        # Called without truth as well: it discards old batches.
        tracks = observed.at(update.stamp_ns)
        if not len(self.truth):
            return []
        groups: dict[str, TrackIds] = {}
        for source, ids in tracks.items():
            name = observed.spaces[source[0]].name
            groups[name] = {**groups.get(name, {}), source: ids}
        shapes = [
            shape for name, group in sorted(groups.items()) for shape in self._space(update, name, group)
        ]
        self.scored |= bool(shapes)
        return [Moment(update.stamp_ns, shapes)] if shapes else []

    def _space(self, update: HypothesisUpdate, name: str, tracks: TrackIds) -> list[Shape]:
        score = score_update(update, self.truth, tracks)
        if not score.scored:
            return []
        if name not in self._spaces:
            self._spaces.append(name)
        number = 2 * self._spaces.index(name)
        nmi, missed = (HUES[(k + number) % len(HUES)] for k in (2, 5))
        path = self._paths(name)
        return [
            value(f"{path}/nmi", score.nmi, f"NMI in {name}", nmi),
            value(f"{path}/wrong", score.misclassification, f"misclassified in {name}", missed),
        ]
