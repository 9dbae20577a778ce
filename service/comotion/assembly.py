"""Joins the updates of all spaces in one message for the wire, with joints, links and events."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from comotion_schemas import UNDETERMINED, Event, HypothesisUpdate, Joint, SourceRef

from .arrays import distinct
from .config import FusionConfig
from .event_time.faults import Faults
from .event_time.stats import Key
from .hypotheses.registry import EVENT_MEMORY_NS
from .joints.joints import Joints
from .linking.linker import Linker
from .partition import SpaceSpec
from .saving import NOT_KEPT
from .shedding import Effort
from .space_update import TRACK, SpaceUpdate

Header = Mapping[str, Any]
"""The plain fields of a HypothesisUpdate by name."""


@dataclass
class Assembly:
    """Makes one message of the updates of all spaces; keeps events, joints and links from one to the next.

    Errors go to `faults`: they cost joints, links and events, or the space that does not fit.
    """

    config: FusionConfig = field(metadata=NOT_KEPT)
    faults: Faults = field(metadata=NOT_KEPT)
    joints: Joints = field(init=False)
    linker: Linker = field(init=False)
    events: deque[Event] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Know nothing of joints, links and events."""
        self.joints, self.linker = Joints(self.config.joints), Linker(self.config.linking)
        self.events.clear()

    def message(
        self,
        header: Header,
        updates: Sequence[SpaceUpdate],
        sessions: Mapping[int, Key],
        effort: Effort,
        reopen: Callable[[SpaceSpec], object],
    ) -> HypothesisUpdate:
        """One message of all spaces, with events, joints and links; the rest is as for :func:`assemble`.

        `effort` says whether joints are judged and links decided; `reopen` builds a space anew that does not
        fit in a message.
        """
        stamp_ns = header["stamp_ns"]
        with self.faults.guard("putting an update together"):
            joints, changes = self.joints.update(stamp_ns, updates, judging=effort.joints)
            self.events.extend([*(event for part in updates for event in part.events), *changes])
            while self.events and self.events[0].stamp_ns < stamp_ns - EVENT_MEMORY_NS:
                self.events.popleft()
            update = assemble(header, updates, sessions, self.events, joints)
            return self.linker.linked(update, updates, deciding=effort.links)
        self.forget()
        fitting: list[SpaceUpdate] = []
        for part in updates:
            with self.faults.guard(f"listing a space ({part.spec.name!r})"):
                assemble(header, [*fitting, part], sessions, [])
                fitting.append(part)
                continue
            reopen(part.spec)
        return assemble(header, fitting, sessions, [])


def assemble(
    header: Header,
    updates: Sequence[SpaceUpdate],
    sessions: Mapping[int, tuple[str, str]],
    events: Sequence[Event],
    joints: Sequence[Joint] = (),
) -> HypothesisUpdate:
    """Build the message of one update from one update per space, in the order of the columns.

    `sessions` are (source, session) by session number, `events` the recent events of all spaces, and `joints`
    those between their hypotheses.
    """
    tracks = np.concatenate([np.zeros(0, TRACK), *(update.tracks for update in updates)])
    numbers, track_source = distinct(tracks["session"])
    keys = [sessions[number] for number in numbers.tolist()]
    return HypothesisUpdate(
        **header,
        sources=[SourceRef(name=source, session=session) for source, session in keys],
        track_source=track_source.astype(np.uint16),
        track_id=tracks["id"],
        track_hypothesis=np.where(tracks["label"] < 0, UNDETERMINED, tracks["label"]).astype(np.uint32),
        track_confidence=np.clip(tracks["confidence"], 0.0, 1.0).astype(np.float32),
        track_position=tracks["position"].astype(np.float32),
        hypotheses=[hypothesis for update in updates for hypothesis in update.hypotheses],
        events=list(events),
        joints=list(joints),
        frames={update.spec.name: update.frame for update in updates if update.frame is not None},
    )


def moved(update: HypothesisUpdate, shift_ns: int) -> HypothesisUpdate:
    """The same update, with all its event times later by `shift_ns`."""
    return replace(
        update,
        stamp_ns=update.stamp_ns + shift_ns,
        hypotheses=[replace(h, born_ns=h.born_ns + shift_ns) for h in update.hypotheses],
        events=[replace(event, stamp_ns=event.stamp_ns + shift_ns) for event in update.events],
    )


def at_rest(update: HypothesisUpdate) -> HypothesisUpdate:
    """The same update without motion: nothing is observed any more, so it is not known what moves."""
    return replace(
        update,
        hypotheses=[
            replace(h, state="undetermined" if h.state == "moving" else h.state, twist=None)
            for h in update.hypotheses
        ],
    )
