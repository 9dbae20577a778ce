"""A scene as shapes, message by message. Pure: time is handed in.

`now` and `arrived` are seconds of one monotonic clock, `wall_ns` is the wall clock. All shapes are
at acquisition times: curves of rates and lags at that of the newest update.
"""

from comotion_schemas import HypothesisUpdate, ObservationBatch, Preview, Status, TruthBatch

from ..scene_model import SceneModel
from ..scoring import Observed
from .agreement import Agreement
from .cameras import Cameras
from .features import Features
from .health import PERIOD_S, Health, event_entry
from .shapes import Layout, Moment

SETTLE_S = 0.15
"""An update is scored this long after its arrival: the batches it rests on are here by then."""
_UNSCORED = 64


class ScenePicture:
    """Follows one scene and says what there is to see.

    Parameters
    ----------
    scene
        Its name.
    """

    def __init__(self, scene: str) -> None:
        self.model = SceneModel(scene)
        self.view_age: float | None = None
        self._agreement = Agreement()
        self._observed = Observed()
        self._features = Features()
        self._cameras = Cameras()
        self._health = Health()
        self._told_at = -float("inf")
        self._drawn_ns: int | None = None
        self._batch_ns: int | None = None
        self._unscored: list[tuple[float, HypothesisUpdate]] = []

    @property
    def layout(self) -> Layout:
        """What needs a view of its own; a space whose features are seen in images does not."""
        cameras = self._cameras.views
        in_images = {
            ref.name for name, ref in self._observed.spaces.items() if name in cameras and ref.unit == "px"
        } - {ref.name for name, ref in self._observed.spaces.items() if name not in cameras}
        spaces = [view for name, view in self._features.views.items() if name not in in_images]
        return Layout(tuple(spaces), tuple(cameras.values()), self._agreement.scored)

    def on_batch(self, batch: ObservationBatch, arrived: float, wall_ns: int) -> None:
        """Take in a batch: which space its source is in, its rate and its lag."""
        self.model.on_batch(batch, arrived, wall_ns)
        self._observed.add(batch)
        self._batch_ns = max(self._batch_ns or 0, min(batch.stamp_ns, wall_ns))

    def on_truth(self, truth: TruthBatch) -> None:
        """Take in what a source says about its features' true objects."""
        self._agreement.truth.add(truth)

    def on_status(self, status: Status) -> None:
        """Take in the Status of a component."""
        self.model.on_status(status)

    def on_presence(self, role: str, name: str, *, alive: bool, now: float) -> None:
        """Take in that a component came or went."""
        self.model.on_presence(role, name, alive=alive, now=now)

    def on_preview(self, preview: Preview, arrived: float) -> None:
        """Take in a camera image; it is drawn once the service has fused what it shows."""
        self._cameras.add(preview, arrived)

    def on_update(self, update: HypothesisUpdate, arrived: float) -> list[Moment]:
        """Draw an update and what has happened; one that repeats a stamp, as time stands still, is not."""
        moments = [Moment(e.stamp_ns, [event_entry(e)]) for e in self.model.on_update(update, arrived)]
        if update.stamp_ns == self._drawn_ns or not _has_time(update):
            return moments
        self._drawn_ns = update.stamp_ns
        self._unscored = [*self._unscored[-_UNSCORED:], (arrived, update)]
        shapes = self._features.draw(update, self._observed.spaces)
        return [*moments, Moment(update.stamp_ns, shapes)]

    def tick(self, now: float) -> list[Moment]:
        """Draw what has become due: images, scores, and twice a second how the scene is."""
        moments = self._cameras.due(self.model.update, now)
        while self._unscored and now - self._unscored[0][0] >= SETTLE_S:
            moments += self._agreement.draw(self._unscored.pop(0)[1], self._observed)
        stamp_ns = self._newest_ns()
        if stamp_ns is not None and now - self._told_at >= PERIOD_S:
            self._told_at = now
            moments.append(Moment(stamp_ns, self._health.draw(self.model.snapshot(now), self.view_age)))
        return moments

    def _newest_ns(self) -> int | None:
        """The time that everything without one of its own is drawn at."""
        update = self.model.update
        return self._batch_ns if update is None or not _has_time(update) else update.stamp_ns


def _has_time(update: HypothesisUpdate) -> bool:
    """Whether an update has a time at all: with an event clock there is none before the first batch."""
    return update.stamp_ns > 0
