"""Logs one scene on topics of Foxglove's SDK: for its WebSocket server, or a file from a recording.

| topic | schema |
|---|---|
| ``/features/<space>`` | foxglove.PointCloud, coloured by hypothesis |
| ``/hypotheses/<space>`` | foxglove.PosesInFrame: centroid, and rotation since birth |
| ``/labels/<space>`` | foxglove.SceneUpdate: name, state, size, velocity and box |
| ``/joints/<space>`` | foxglove.SceneUpdate: axis, range, and the joint in words |
| ``/tf`` | foxglove.FrameTransforms: frames ``hypothesis-<id>`` |
| ``/images/<source>`` | foxglove.CompressedImage |
| ``/events`` | foxglove.Log: events of bodies |
| ``/health`` | foxglove.Log: what the components say of themselves |
| ``/numbers`` | comotion.Numbers: counts, confidence, lag, and NMI where truth is known |

Log times are given by the caller; time stamps within messages are acquisition times.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import foxglove
import numpy as np
from foxglove import channels

from comotion_schemas import HypothesisUpdate, Message, ObservationBatch, Preview, Status, TruthBatch
from comotion_schemas.errors import KnownError
from comotion_schemas.hypotheses import Event
from comotion_schemas.naming import Names, event_words
from comotion_schemas.text import counted
from comotion_schemas.transport import LOOPBACK

from ..bodies import poses_in_space
from ..feed import Display, play
from ..metrics import score_update
from ..scoring import spaces_of
from . import messages

_COUNTS = ("hypotheses", "moving", "tracks", "undetermined")
_VALUES = ("mean_confidence", "lag_s", "nmi", "misclassification")
_NUMBERS_SCHEMA = {
    "title": "comotion.Numbers",
    "type": "object",
    "properties": {
        **{name: {"type": "integer"} for name in _COUNTS},
        **{name: {"type": "number"} for name in _VALUES},
    },
}


class FoxgloveScene(Display):
    """Logs the messages of a scene to the sinks of a context.

    Servers and files of the SDK listen at the `context`; `names` are those of hypotheses by id.

    Attributes
    ----------
    logged
        Number of messages by topic.
    """

    def __init__(self, context: foxglove.Context, names: Names | None = None) -> None:
        super().__init__("", names)
        self.logged: Counter[str] = Counter()
        self._context = context
        self._channels: dict[str, Any] = {}

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Event]:
        """Log what one message shows, at the time of its receipt; returns its new events."""
        log_ns, events = wall_ns, super().on_message(message, arrived, wall_ns)
        match message:
            case ObservationBatch() | TruthBatch():
                self.scoring.add(message)
            case HypothesisUpdate():
                self._log_update(log_ns, message)
            case Preview():
                self._log(f"/images/{message.source}", log_ns, messages.image(message))
            case Status():
                text = f"{message.state} {message.message}".strip()
                line = messages.line(message.stamp_ns, message.state, text, message.component)
                self._log("/health", log_ns, line)
        for event in events:
            words = event_words(event, self.names)
            self._log("/events", log_ns, messages.line(event.stamp_ns, "ok", words, "comotion"))
        return events

    def _log_update(self, log_ns: int, update: HypothesisUpdate) -> None:
        update = poses_in_space(update)
        score = score_update(update, self.scoring.truth, self.scoring.observed.at(update.stamp_ns))
        scored = score.scored > 0 and not math.isnan(score.nmi)
        scores = (score.nmi, score.misclassification) if scored else (None, None)
        self._log("/numbers", log_ns, messages.numbers(update, *scores))
        space_of = [ref.name for ref in spaces_of(update, self.scoring.observed.spaces)]
        for space in dict.fromkeys([*space_of, *(h.space for h in update.hypotheses)]):
            self._draw(log_ns, update, space, space_of)
        scales = {h.space: self._scale(h.space) for h in update.hypotheses}
        self._log("/tf", log_ns, messages.transforms(update, scales))

    def _draw(self, log_ns: int, update: HypothesisUpdate, space: str, space_of: list[str]) -> None:
        drawing = messages.SpaceDrawing(update, space, self._scale(space), self.palette, self.names)
        members = np.array([name == space for name in space_of], bool)
        rows = np.flatnonzero(members[update.track_source]) if len(members) else np.empty(0, np.intp)
        self._log(f"/features/{space}", log_ns, drawing.points(rows))
        self._log(f"/hypotheses/{space}", log_ns, drawing.poses())
        self._log(f"/labels/{space}", log_ns, drawing.labels())
        self._log(f"/joints/{space}", log_ns, drawing.joints())

    def _scale(self, space: str) -> float:
        units = {ref.unit for ref in self.scoring.observed.spaces.values() if ref.name == space}
        return messages.PIXEL_M if units == {"px"} else 1.0

    def _log(self, topic: str, log_ns: int, message: Any) -> None:
        """Log a message; None is nothing to log."""
        if message is None:
            return
        if topic not in self._channels:
            schema = {"schema": _NUMBERS_SCHEMA} if isinstance(message, dict) else {}
            kind = foxglove.Channel if schema else getattr(channels, f"{type(message).__name__}Channel")
            self._channels[topic] = kind(topic, context=self._context, **schema)
        self._channels[topic].log(message, log_time=max(log_ns, 0))
        self.logged[topic] += 1


_BACKLOG = 256
"""Messages that wait for a slow client; then the oldest are dropped."""


class FoxgloveDisplay(FoxgloveScene):
    """Serves a scene to Foxglove; a context manager, for a running scene or a recording.

    The TCP `port` is on this machine alone, 0: a free one; `names` are those of hypotheses by id.

    Raises
    ------
    OSError
        If the port is in use.
    """

    def __init__(self, port: int, names: Names | None = None) -> None:
        context = foxglove.Context()
        super().__init__(context, names)
        try:
            self._server = foxglove.start_server(
                name="comotion", host=LOOPBACK, port=port, context=context, message_backlog_size=_BACKLOG
            )
        except Exception as error:  # the SDK's own, without a class for a port in use
            raise OSError(f"no server on {LOOPBACK}:{port}: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._server.stop()

    @property
    def url(self) -> str:
        """Where Foxglove finds the scene."""
        return f"ws://{LOOPBACK}:{self._server.port}"


@dataclass
class Exported:
    """Result of an export: number of messages by topic; `invalid` payloads were left out."""

    messages: dict[str, int] = field(default_factory=dict)
    invalid: int = 0

    def lines(self, target: Path) -> list[str]:
        """Format the result as text."""
        total = sum(self.messages.values())
        lines = [f"{target}: {counted(total, 'message')} on {counted(len(self.messages), 'topic')}"]
        lines += [f"  {topic}: {count}" for topic, count in sorted(self.messages.items())]
        if self.invalid:
            lines.append(f"left out as invalid: {self.invalid}")
        return lines


def export(source: Path, target: Path, names: Names | None = None) -> Exported:
    """Convert a recording to a file for Foxglove.

    The `source` is a recording of ``comotion record`` that includes the service; the `target` must not exist;
    `names` are those of hypotheses by id.

    Raises
    ------
    ValueError
        If the recording is damaged or holds no update of a service.
    OSError
        If a file cannot be read or written, or `target` exists.
    """
    from comotion_schemas.message_log import MessageLog  # the server needs no extra `record`

    context = foxglove.Context()
    with MessageLog(source) as log, target.open("xb") as output:
        try:
            with foxglove.open_mcap(output, context=context):
                scene = FoxgloveScene(context, names)
                play(scene, log.decoded())
            if not scene.logged.get("/numbers"):
                raise KnownError(f"{source}: it holds no hypotheses; was the service recorded?")
        except BaseException:
            target.unlink()
            raise
    return Exported(scene.logged, log.invalid)
