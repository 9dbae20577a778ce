"""Joins the updates of all spaces in one message for the wire, with joints, links and events."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from comotion_schemas import UNDETERMINED, Event, HypothesisUpdate, Joint, SourceRef

from .arrays import distinct
from .config import FusionConfig
from .event_time.faults import Faults
from .event_time.stats import Key
from .hypotheses.events import EVENT_MEMORY_NS
from .joints.joints import Joints
from .linking.linker import Linker
from .partition import SpaceSpec
from .saving import plain, refill, restored
from .shedding import Effort
from .space_update import SpaceUpdate


class Header(NamedTuple):
    """The plain fields of a HypothesisUpdate, with its names."""

    scene: str
    session: str
    seq: int
    stamp_ns: int
    published_ns: int
    period_ns: int
    live: bool


@dataclass
class Assembly:
    """Makes one message of the updates of all spaces; keeps events, joints and links from one to the next.

    Errors go to `faults`: they cost joints, links and events, or the space that does not fit.
    """

    config: FusionConfig
    faults: Faults
    _events: deque[Event] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._joints, self._linker = Joints(self.config.joints), Linker(self.config.linking)
        self._events.clear()

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
        views = [part.view for part in updates]
        with self.faults.guard("putting an update together"):
            joints, changes = self._joints.update(header.stamp_ns, views, judging=effort.joints)
            self._joints.keep(h.id for part in updates for h in part.hypotheses)
            self._remember(header.stamp_ns, [*(event for part in updates for event in part.events), *changes])
            update = assemble(header, updates, sessions, self._events, joints)
            return self._linker.linked(update, views, deciding=effort.links)
        self._forget()
        fitting: list[SpaceUpdate] = []
        for part in updates:
            with self.faults.guard(f"listing space {part.view.spec.name!r}"):
                assemble(header, [*fitting, part], sessions, [])
                fitting.append(part)
                continue
            reopen(part.view.spec)
        return assemble(header, fitting, sessions, [])

    def _remember(self, stamp_ns: int, events: Sequence[Event]) -> None:
        """Keep the events that updates still list."""
        self._events.extend(events)
        while self._events and self._events[0].stamp_ns < stamp_ns - EVENT_MEMORY_NS:
            self._events.popleft()

    def state(self) -> dict[str, Any]:
        """Events, links and joints as plain values."""
        return {
            "events": plain(self._events),
            "links": plain(self._linker.links),
            "joints": plain(self._joints),
        }

    def load(self, state: dict[str, Any], *, keep_joints: bool) -> None:
        """Take up :meth:`state`; joints are those of a method."""
        self._events = restored(deque[Event], state["events"])
        self._linker.links = restored(dict[int, int], state["links"])
        if keep_joints:
            refill(self._joints, state["joints"])


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
    owners = np.concatenate([np.zeros(0, np.intp), *(update.sessions for update in updates)])
    numbers, track_source = distinct(owners)
    labels = np.concatenate([np.zeros(0, np.int64), *(update.labels for update in updates)])
    confidence = np.concatenate([np.zeros(0), *(update.confidence for update in updates)])
    positions = np.concatenate([np.zeros((0, 3)), *(update.positions for update in updates)])
    keys = [sessions[number] for number in numbers.tolist()]
    return HypothesisUpdate(
        **header._asdict(),
        sources=[SourceRef(name=source, session=session) for source, session in keys],
        track_source=track_source.astype(np.uint16),
        track_id=np.concatenate([np.zeros(0, np.uint64), *(update.ids for update in updates)]),
        track_hypothesis=np.where(labels < 0, UNDETERMINED, labels).astype(np.uint32),
        track_confidence=np.clip(confidence, 0.0, 1.0).astype(np.float32),
        track_position=positions.astype(np.float32),
        hypotheses=[hypothesis for update in updates for hypothesis in update.hypotheses],
        events=list(events),
        joints=list(joints),
        frames={update.view.spec.name: update.frame for update in updates if update.frame is not None},
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
