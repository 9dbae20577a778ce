"""Joins the updates of all spaces in one message for the wire."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comotion_schemas import UNDETERMINED, Event, HypothesisUpdate, Joint, SourceRef

from .arrays import distinct
from .space import SpaceUpdate


class Header(NamedTuple):
    """The plain fields of a HypothesisUpdate, with its names."""

    scene: str
    session: str
    seq: int
    stamp_ns: int
    published_ns: int
    period_ns: int
    live: bool


def assemble(
    header: Header,
    updates: Sequence[SpaceUpdate],
    sessions: Mapping[int, tuple[str, str]],
    events: Sequence[Event],
    joints: Sequence[Joint] = (),
) -> HypothesisUpdate:
    """Build the message of one update.

    Parameters
    ----------
    header
        Its plain fields.
    updates
        One per space, in the order of the columns.
    sessions
        (source, session) by session number.
    events
        The recent events of all spaces.
    joints
        Between their hypotheses.
    """
    owners = np.concatenate([np.zeros(0, np.intp), *(one.sessions for one in updates)])
    used, track_source = distinct(owners)
    labels = np.concatenate([np.zeros(0, np.int64), *(one.labels for one in updates)])
    confidence = np.concatenate([np.zeros(0), *(one.confidence for one in updates)])
    positions = np.concatenate([np.zeros((0, 3)), *(one.positions for one in updates)])
    return HypothesisUpdate(
        **header._asdict(),
        sources=[
            SourceRef(name=sessions[number][0], session=sessions[number][1]) for number in used.tolist()
        ],
        track_source=track_source.astype(np.uint16),
        track_id=np.concatenate([np.zeros(0, np.uint64), *(one.ids for one in updates)]),
        track_hypothesis=np.where(labels < 0, UNDETERMINED, labels).astype(np.uint32),
        track_confidence=np.clip(confidence, 0.0, 1.0).astype(np.float32),
        track_position=positions.astype(np.float32),
        hypotheses=[hypothesis for one in updates for hypothesis in one.hypotheses],
        events=list(events),
        joints=list(joints),
        frames={one.view.spec.name: one.frame for one in updates if one.frame is not None},
    )


def moved(update: HypothesisUpdate, shift_ns: int) -> HypothesisUpdate:
    """The same update, with all its event times later by `shift_ns`."""
    return replace(
        update,
        stamp_ns=update.stamp_ns + shift_ns,
        hypotheses=[replace(one, born_ns=one.born_ns + shift_ns) for one in update.hypotheses],
        events=[replace(one, stamp_ns=one.stamp_ns + shift_ns) for one in update.events],
    )


def at_rest(update: HypothesisUpdate) -> HypothesisUpdate:
    """The same update without motion: nothing is observed any more, so that nobody knows what moves."""
    return replace(
        update,
        hypotheses=[
            replace(one, state="undetermined" if one.state == "moving" else one.state, twist=None)
            for one in update.hypotheses
        ],
    )
