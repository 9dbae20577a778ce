"""Foxglove export: recording -> MCAP file with points, poses, labels, images, events and numbers in JSON.

| topic | schema |
|---|---|
| ``/features/<space>`` | foxglove.PointCloud, coloured by hypothesis |
| ``/hypotheses/<space>`` | foxglove.PosesInFrame: centroid, and rotation since birth |
| ``/labels/<space>`` | foxglove.SceneUpdate: id, state, size, velocity and box |
| ``/tf`` | foxglove.FrameTransforms: frames ``hypothesis-<id>`` |
| ``/images/<source>`` | foxglove.CompressedImage, where previews were recorded |
| ``/events`` | foxglove.Log |
| ``/numbers`` | comotion.Numbers: counts, confidence, lag, and NMI where truth was recorded |
| ``/health/<component>`` | comotion.Health: rates, ages, counters, rejections |

Log times are those of the recording; time stamps within messages are acquisition times.
"""

import json
import math
import os
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from comotion_schemas import (
    HypothesisUpdate,
    Message,
    ObservationBatch,
    Preview,
    Status,
    TruthBatch,
)
from comotion_schemas.colours import Palette
from comotion_schemas.errors import KnownError
from comotion_schemas.message_log import MessageLog
from comotion_schemas.recording import SCHEMA_ENCODING

from ..carried import poses_in_space
from ..metrics import Truth
from ..scoring import Observed, Tally, spaces_of
from . import foxglove
from .disk import create
from .foxglove_schemas import SCHEMAS, Json
from .topics import Definition, TopicWriter


@dataclass
class Exported:
    """Result of an export: number of messages by topic; `invalid` payloads were left out."""

    messages: dict[str, int] = field(default_factory=dict)
    invalid: int = 0

    def as_json(self) -> Json:
        """Convert to plain values."""
        return asdict(self)

    def lines(self, target: Path) -> list[str]:
        """Format the result as text."""
        total = sum(self.messages.values())
        lines = [f"{target}: {total} messages on {len(self.messages)} topics"]
        lines += [f"  {topic}: {count}" for topic, count in sorted(self.messages.items())]
        if self.invalid:
            lines.append(f"left out as invalid: {self.invalid}")
        return lines


def export(source: Path, target: Path) -> Exported:
    """Convert a recording to a file for Foxglove.

    Parameters
    ----------
    source
        A recording of ``comotion record`` that includes the service.
    target
        The new file; it must not exist.

    Raises
    ------
    ValueError
        If the recording is damaged or holds no update of a service.
    OSError
        If a file cannot be read or written, or `target` exists.
    """
    with MessageLog(source) as log, os.fdopen(create(target), "wb") as output:
        try:
            exporter = _Exporter(TopicWriter(output))
            for log_ns, message in log.decoded():
                exporter.add(log_ns, message)
            exporter.exported.invalid = log.invalid
            exporter.close()
            if not exporter.exported.messages.get("/numbers"):
                raise KnownError(f"{source}: it holds no hypotheses; was the service recorded?")
        except BaseException:
            target.unlink()
            raise
    return exporter.exported


class _Exporter:
    """Converts messages one by one."""

    def __init__(self, writer: TopicWriter) -> None:
        self.exported = Exported()
        self._writer = writer
        self._observed = Observed()
        self._palette = Palette()
        self._tally = Tally(Truth())
        self._written_events: set[tuple[int, str, int]] = set()

    def add(self, log_ns: int, message: Message) -> None:
        """Convert one message of the recording."""
        match message:
            case ObservationBatch():
                self._observed.add(message)
            case TruthBatch():
                self._tally.truth.add(message)
            case HypothesisUpdate():
                self._update(log_ns, message)
            case Preview():
                self._put(
                    f"/images/{message.source}", "foxglove.CompressedImage", log_ns, foxglove.image(message)
                )
            case Status():
                self._put(f"/health/{message.component}", "comotion.Health", log_ns, foxglove.health(message))

    def close(self) -> None:
        """Complete the file."""
        self._writer.finish()

    def _update(self, log_ns: int, update: HypothesisUpdate) -> None:
        self._palette.see(update.hypotheses)
        update = poses_in_space(update)
        score = self._tally.add(update, self._observed)
        scored = score.scored > 0 and not math.isnan(score.nmi)
        self._put(
            "/numbers",
            "comotion.Numbers",
            log_ns,
            foxglove.numbers(
                update,
                score.nmi if scored else None,
                score.misclassification if scored else None,
            ),
        )
        space_of = [ref.name for ref in spaces_of(update, self._observed.spaces)]
        for space in dict.fromkeys([*space_of, *(h.space for h in update.hypotheses)]):
            self._draw(log_ns, update, space, space_of)
        moved = foxglove.transforms(update, {h.space: self._scale(h.space) for h in update.hypotheses})
        if moved["transforms"]:
            self._put("/tf", "foxglove.FrameTransforms", log_ns, moved)
        self._events(log_ns, update)

    def _draw(self, log_ns: int, update: HypothesisUpdate, space: str, space_of: list[str]) -> None:
        scale = self._scale(space)
        members = np.array([name == space for name in space_of], bool)
        rows = np.flatnonzero(members[update.track_source]) if len(members) else np.empty(0, np.intp)
        cloud = foxglove.point_cloud(update, space, rows, scale, self._palette)
        self._put(f"/features/{space}", "foxglove.PointCloud", log_ns, cloud)
        poses = foxglove.poses(update, space, scale)
        self._put(f"/hypotheses/{space}", "foxglove.PosesInFrame", log_ns, poses)
        labels = foxglove.labels(update, space, scale, self._palette)
        self._put(f"/labels/{space}", "foxglove.SceneUpdate", log_ns, labels)
        joints = foxglove.joints(update, space, scale, self._palette)
        if joints["entities"]:
            self._put(f"/joints/{space}", "foxglove.SceneUpdate", log_ns, joints)

    def _scale(self, space: str) -> float:
        units = {ref.unit for ref in self._observed.spaces.values() if ref.name == space}
        return foxglove.PIXEL_M if units == {"px"} else 1.0

    def _events(self, log_ns: int, update: HypothesisUpdate) -> None:
        """Write each event once, although updates repeat it for 2 s."""
        for event in update.events:
            key = (event.stamp_ns, event.kind, event.hypothesis)
            if key not in self._written_events:
                self._written_events.add(key)
                self._put("/events", "foxglove.Log", log_ns, foxglove.log_line(event))

    def _put(self, topic: str, schema: str, log_ns: int, content: Json) -> None:
        data = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
        self._writer.add(topic, _definition(schema), "json", data, log_ns)
        self.exported.messages[topic] = self.exported.messages.get(topic, 0) + 1


@cache
def _definition(schema: str) -> Definition:
    return Definition(schema, SCHEMA_ENCODING, json.dumps(SCHEMAS[schema]).encode())
