"""Draws the messages of one scene. Pure: the caller passes the time.

`now` and `arrived` are seconds of one monotonic clock, `wall_ns` is the wall clock in nanoseconds. All
shapes are at acquisition times; curves of rates and lags are at the stamp of the newest update.
"""

from typing import TYPE_CHECKING

from comotion_schemas import HypothesisUpdate, Message, ObservationBatch, Preview
from comotion_schemas.colours import HUES
from comotion_schemas.naming import Names, event_words

from ..feed import Display
from ..metrics import TrackIds, score_update
from ..scene_model import SceneModel
from ..scoring import Scoring
from .drawing import Layout, Moment, Shape, entry, value
from .features import Cameras, Features
from .health import PERIOD_S, Health
from .paths import Paths

if TYPE_CHECKING:
    from .sink import RerunSink


class ScenePicture(Display):
    """Converts the messages of one scene to shapes, and draws them to a window, page or file.

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
    sink
        Where they are drawn; None: nowhere.
    """

    def __init__(
        self,
        scene: str,
        rate: float | None = None,
        *,
        dense: bool = False,
        names: Names | None = None,
        sink: "RerunSink | None" = None,
    ) -> None:
        self._sink = sink
        self._moments: list[Moment] = []
        self.model = SceneModel(scene, names)
        self._gap = 0.0 if rate is None else 1 / rate
        self._drawn_at: dict[str, float] = {}
        self.view_age: float | None = None
        self._score_paths = Paths("scores")
        self._score_hues: dict[str, int] = {}
        self._scoring = Scoring()
        self._features = Features(self.model.palette, self.model.names)
        self._cameras = Cameras(self.model.palette, self.model.names, dense=dense)
        self._health = Health()
        self._health_at = -float("inf")
        self._drawn_ns: int | None = None
        self._batch_ns: int | None = None

    @property
    def layout(self) -> Layout:
        """Spaces and cameras with a view; a pixel space whose features are in images needs none."""
        cameras, published = self._cameras.views, self._scoring.observed.spaces.items()
        in_images = {ref.name for name, ref in published if name in cameras and ref.unit == "px"}
        in_images -= {ref.name for name, ref in published if name not in cameras}
        spaces = [view for name, view in self._features.views.items() if name not in in_images]
        return Layout(tuple(spaces), tuple(cameras.values()), bool(self._score_hues))

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Moment]:
        """Add a message of any kind; returns what is to be drawn at once.

        An image is drawn when the service has fused its instant; an update that repeats a stamp not again.
        """
        model, moments = self.model, []
        for event in model.on_message(message, arrived, wall_ns):
            words, colour = event_words(event, model.names), model.palette.legible(event.hypothesis)
            moments.append(Moment(event.stamp_ns, [entry(event.stamp_ns, words, colour)]))
        self._scoring.add(message, arrived)
        match message:
            case ObservationBatch():
                self._batch_ns = max(self._batch_ns or 0, min(message.stamp_ns, wall_ns))
            case Preview() if self._wanted(f"image {message.source}", arrived):
                self._cameras.add(message, arrived)
            case HypothesisUpdate() if message.stamp_ns != self._drawn_ns and _has_time(message):
                self._drawn_ns = message.stamp_ns
                if self._wanted("update", arrived):
                    shapes = self._features.draw(message, self._scoring.observed.spaces)
                    moments.append(Moment(message.stamp_ns, shapes))
        if self._sink is not None:
            self._moments += moments
        return moments

    def on_presence(self, role: str, token: str, *, alive: bool, now: float) -> None:
        """Show who comes and goes."""
        self.model.on_presence(role, token, alive=alive, now=now)

    def on_age(self, age_s: float | None) -> None:
        """The age is a curve."""
        self.view_age = age_s

    @property
    def closed(self) -> bool:
        """Whether the user has closed the window."""
        return self._sink is not None and self._sink.closed

    def refresh(self, now: float) -> None:
        """Arrange the views and show what has come."""
        moments, self._moments = self._moments + self.tick(now), []
        if self._sink is not None:
            self._sink.arrange(self.layout)
            self._sink.show(moments)

    def tick(self, now: float) -> list[Moment]:
        """Draw what is due at `now`: images, scores, and twice a second the health of the scene."""
        moments = self._cameras.due(self.model.update, now)
        scores = ((fused.stamp_ns, self._scores(fused)) for fused in self._scoring.due(now))
        moments += [Moment(stamp_ns, shapes) for stamp_ns, shapes in scores if shapes]
        update = self.model.update
        stamp_ns = self._batch_ns if update is None or not _has_time(update) else update.stamp_ns
        if stamp_ns is not None and now - self._health_at >= PERIOD_S:
            self._health_at = now
            shapes = self._health.draw(self.model.snapshot(now), self.view_age, stamp_ns)
            moments.append(Moment(stamp_ns, shapes))
        return moments

    def _scores(self, update: HypothesisUpdate) -> list[Shape]:
        """Curves of the scores of an update in each space; none without truth."""
        # Called without truth as well: it discards old batches.
        groups: dict[str, TrackIds] = {}
        for source, ids in self._scoring.observed.at(update.stamp_ns).items():
            name = self._scoring.observed.spaces[source[0]].name
            groups[name] = {**groups.get(name, {}), source: ids}
        shapes = []
        for name, group in sorted(groups.items()):
            score = score_update(update, self._scoring.truth, group)
            if score.scored:
                first = self._score_hues.setdefault(name, 2 * len(self._score_hues))
                nmi, missed = (HUES[(k + first) % len(HUES)] for k in (2, 5))
                path = self._score_paths(name)
                shapes.append(value(f"{path}/nmi", score.nmi, f"NMI in {name}", nmi))
                missing = f"misclassified in {name}"
                shapes.append(value(f"{path}/wrong", score.misclassification, missing, missed))
        return shapes

    def _wanted(self, what: str, arrived: float) -> bool:
        """Whether the last one that is drawn was long enough ago; of steady ones, every k-th is."""
        since = arrived - self._drawn_at.get(what, -float("inf"))
        if since < 0.9 * self._gap:
            return False
        self._drawn_at[what] = arrived
        return True


def _has_time(update: HypothesisUpdate) -> bool:
    """Whether an update has a stamp: with an event clock it is 0 before the first batch."""
    return update.stamp_ns > 0
