"""Scene picture: messages of one scene -> shapes. Pure: the caller passes the time.

`now` and `arrived` are seconds of one monotonic clock, `wall_ns` is the wall clock in nanoseconds. All
shapes are at acquisition times; curves of rates and lags are at the stamp of the newest update.
"""

from comotion_schemas import HypothesisUpdate, Message, ObservationBatch, Preview, Status, TruthBatch
from comotion_schemas.naming import Names

from ..scene_model import SceneModel
from ..scoring import SETTLE_S, Observed
from .cameras import Cameras
from .features import Features
from .health import PERIOD_S, Health, event_entry
from .scores import ScoreCurves
from .shapes import Layout, Moment

_MAX_UNSCORED = 64  # updates that wait for SETTLE_S


class ScenePicture:
    """Converts the messages of one scene to shapes.

    Parameters
    ----------
    scene
        Name of the scene.
    rate
        Most updates, and images of a camera, that are drawn per second; the others are left out. None: all.
    dense
        Whether to draw the regions of hypotheses in images.
    names
        Names of hypotheses by id.
    """

    def __init__(
        self, scene: str, rate: float | None = None, *, dense: bool = False, names: Names | None = None
    ) -> None:
        self.model = SceneModel(scene, names)
        self._gap = 0.0 if rate is None else 1 / rate
        self._drawn_at: dict[str, float] = {}
        self.view_age: float | None = None
        self._agreement = ScoreCurves()
        self._observed = Observed()
        self._features = Features(self.model.palette, self.model.names)
        self._cameras = Cameras(self.model.palette, self.model.names, dense=dense)
        self._health = Health()
        self._health_at = -float("inf")
        self._drawn_ns: int | None = None
        self._batch_ns: int | None = None
        self._unscored: list[tuple[float, HypothesisUpdate]] = []

    @property
    def layout(self) -> Layout:
        """Spaces and cameras with a view; a pixel space whose features are in images needs none."""
        cameras = self._cameras.views
        in_images = {
            ref.name for name, ref in self._observed.spaces.items() if name in cameras and ref.unit == "px"
        } - {ref.name for name, ref in self._observed.spaces.items() if name not in cameras}
        spaces = [view for name, view in self._features.views.items() if name not in in_images]
        return Layout(tuple(spaces), tuple(cameras.values()), self._agreement.scored)

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Moment]:
        """Add a message of any kind; returns what is to be drawn at once."""
        match message:
            case ObservationBatch():
                self.on_batch(message, arrived, wall_ns)
            case TruthBatch():
                self.on_truth(message)
            case Status():
                self.on_status(message)
            case Preview():
                self.on_preview(message, arrived)
            case HypothesisUpdate():
                return self.on_update(message, arrived)
        return []

    def on_batch(self, batch: ObservationBatch, arrived: float, wall_ns: int) -> None:
        """Add a batch: space, rate and lag of its source."""
        self.model.on_batch(batch, arrived, wall_ns)
        self._observed.add(batch)
        self._batch_ns = max(self._batch_ns or 0, min(batch.stamp_ns, wall_ns))

    def on_truth(self, truth: TruthBatch) -> None:
        """Add the true objects of features."""
        self._agreement.truth.add(truth)

    def on_status(self, status: Status) -> None:
        """Add the Status of a component."""
        self.model.on_status(status)

    def on_presence(self, role: str, name: str, *, alive: bool, now: float) -> None:
        """Process that a component entered or left the scene."""
        self.model.on_presence(role, name, alive=alive, now=now)

    def on_preview(self, preview: Preview, arrived: float) -> None:
        """Add a camera image; it is drawn when the service has fused its instant."""
        if self._wanted(f"image {preview.source}", arrived):
            self._cameras.add(preview, arrived)

    def on_update(self, update: HypothesisUpdate, arrived: float) -> list[Moment]:
        """Draw an update and its new events; an update that repeats a stamp is not drawn again."""
        moments = [
            Moment(e.stamp_ns, [event_entry(e, self.model.palette, self.model.names)])
            for e in self.model.on_update(update, arrived)
        ]
        if update.stamp_ns == self._drawn_ns or not _has_time(update):
            return moments
        self._drawn_ns = update.stamp_ns
        self._unscored = [*self._unscored[-_MAX_UNSCORED:], (arrived, update)]
        if not self._wanted("update", arrived):
            return moments
        shapes = self._features.draw(update, self._observed.spaces)
        return [*moments, Moment(update.stamp_ns, shapes)]

    def tick(self, now: float) -> list[Moment]:
        """Draw what is due at `now`: images, scores, and twice a second the health of the scene."""
        moments = self._cameras.due(self.model.update, now)
        while self._unscored and now - self._unscored[0][0] >= SETTLE_S:
            moments += self._agreement.draw(self._unscored.pop(0)[1], self._observed)
        stamp_ns = self._newest_ns()
        if stamp_ns is not None and now - self._health_at >= PERIOD_S:
            self._health_at = now
            moments.append(Moment(stamp_ns, self._health.draw(self.model.snapshot(now), self.view_age)))
        return moments

    def _wanted(self, what: str, arrived: float) -> bool:
        """Whether the last one that is drawn was long enough ago; of steady ones, every k-th is."""
        since = arrived - self._drawn_at.get(what, -float("inf"))
        if since < 0.9 * self._gap:
            return False
        self._drawn_at[what] = arrived
        return True

    def _newest_ns(self) -> int | None:
        """Stamp for shapes without an acquisition time."""
        update = self.model.update
        return self._batch_ns if update is None or not _has_time(update) else update.stamp_ns


def _has_time(update: HypothesisUpdate) -> bool:
    """Whether an update has a stamp: with an event clock it is 0 before the first batch."""
    return update.stamp_ns > 0
