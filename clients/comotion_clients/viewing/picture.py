"""Draws the messages of one scene. Pure: the caller passes the time.

`now` and `arrived` are seconds of one monotonic clock, `wall_ns` is the wall clock in nanoseconds. All
shapes are at acquisition times; curves of rates and lags are at the stamp of the newest update.
"""

from typing import TYPE_CHECKING

from comotion_schemas import Event, HypothesisUpdate, Message, ObservationBatch, Preview
from comotion_schemas.colours import HUES
from comotion_schemas.naming import Names, event_words

from ..feed import Display
from ..metrics import TrackIds, score_update
from .drawing import Layout, Moment, Shape, entry, value
from .features import Cameras, Features
from .health import PERIOD_S, Health
from .paths import Paths

if TYPE_CHECKING:
    from .sink import RerunSink


class ScenePicture(Display):
    """Converts the messages of one scene to shapes, and draws them to a window, page or file.

    `moments` are those to be shown at the next :meth:`refresh`.

    Most updates, and images of a camera, that are drawn per second are `rate`, None: all; the others are left
    out. `dense` draws the regions of hypotheses in images, `names` are those of hypotheses by id, and without
    a `sink` nothing is shown.
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
        super().__init__(scene, names)
        self._sink = sink
        self.moments: list[Moment] = []
        self._gap = 0.0 if rate is None else 1 / rate
        self._drawn_at: dict[str, float] = {}
        self._score_paths = Paths("scores")
        self._score_hues: dict[str, int] = {}
        self._features = Features(self.palette, self.names)
        self._cameras = Cameras(self.palette, self.names, dense=dense)
        self._health = Health()
        self._health_at = -float("inf")
        self._drawn_ns: int | None = None
        self._batch_ns: int | None = None

    @property
    def layout(self) -> Layout:
        """Spaces and cameras with a view; a pixel space whose features are in images needs none."""
        cameras, published = self._cameras.views, self.scoring.observed.spaces.items()
        in_images = {ref.name for name, ref in published if name in cameras and ref.unit == "px"}
        in_images -= {ref.name for name, ref in published if name not in cameras}
        spaces = [view for name, view in self._features.views.items() if name not in in_images]
        return Layout(tuple(spaces), tuple(cameras.values()), bool(self._score_hues))

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Event]:
        """Add a message of any kind, and draw it; returns the events that no earlier update had.

        An image is drawn when the service has fused its instant; an update that repeats a stamp not again.
        """
        events = super().on_message(message, arrived, wall_ns)
        for event in events:
            words, colour = event_words(event, self.names), self.palette.legible(event.hypothesis)
            self.moments.append(Moment(event.stamp_ns, [entry(event.stamp_ns, words, colour)]))
        self.scoring.add(message, arrived)
        match message:
            case ObservationBatch():
                self._batch_ns = max(self._batch_ns or 0, min(message.stamp_ns, wall_ns))
            case Preview() if self._wanted(f"image {message.source}", arrived):
                self._cameras.add(message, arrived)
            case HypothesisUpdate() if message.stamp_ns != self._drawn_ns and _has_time(message):
                self._drawn_ns = message.stamp_ns
                if self._wanted("update", arrived):
                    shapes = self._features.draw(message, self.scoring.observed.spaces)
                    self.moments.append(Moment(message.stamp_ns, shapes))
        return events

    @property
    def closed(self) -> bool:
        """Whether the user has closed the window."""
        return self._sink is not None and self._sink.closed

    def refresh(self, now: float) -> None:
        """Arrange the views and show what has come."""
        moments, self.moments = self.moments + self.tick(now), []
        if self._sink is not None:
            self._sink.arrange(self.layout)
            self._sink.show(moments)

    def tick(self, now: float) -> list[Moment]:
        """Draw what is due at `now`: images, scores, and twice a second the health of the scene."""
        moments = self._cameras.due(self.update, now)
        scores = ((fused.stamp_ns, self._scores(fused)) for fused in self.scoring.due(now))
        moments += [Moment(stamp_ns, shapes) for stamp_ns, shapes in scores if shapes]
        update = self.update
        stamp_ns = self._batch_ns if update is None or not _has_time(update) else update.stamp_ns
        if stamp_ns is not None and now - self._health_at >= PERIOD_S:
            self._health_at = now
            shapes = self._health.draw(self.snapshot(now), self.age_s, stamp_ns)
            moments.append(Moment(stamp_ns, shapes))
        return moments

    def _scores(self, update: HypothesisUpdate) -> list[Shape]:
        """Curves of the scores of an update in each space; none without truth."""
        # Called without truth as well: it discards old batches.
        groups: dict[str, TrackIds] = {}
        for source, ids in self.scoring.observed.at(update.stamp_ns).items():
            name = self.scoring.observed.spaces[source[0]].name
            groups[name] = {**groups.get(name, {}), source: ids}
        shapes = []
        for name, group in sorted(groups.items()):
            score = score_update(update, self.scoring.truth, group)
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
