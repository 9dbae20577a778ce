"""Names of hypotheses by default: those that sources give to the features that they hold."""

from dataclasses import replace

import numpy as np

from comotion_clients.feature_names import HypothesisNames
from comotion_schemas import Status
from comotion_schemas.hypotheses import SourceRef

from .test_joint_clients import DOOR, update

SESSION = "0" * 16
STATUS = Status(
    component="arm",
    role="source",
    session=SESSION,
    stamp_ns=1,
    state="ok",
    rates={},
    ages={},
    counters={},
    rejected={},
    message="",
    feature_names={"0": "elbow", "1": "tool"},
)


def held(*hypotheses, session=SESSION):
    """An update whose features 0, 1, ... of the arm are in these hypotheses."""
    count = len(hypotheses)
    return replace(
        update([DOOR]),
        sources=[SourceRef(name="arm", session=session)],
        track_source=np.zeros(count, np.uint16),
        track_id=np.arange(count, dtype=np.uint64),
        track_hypothesis=np.array(hypotheses, np.uint32),
        track_confidence=np.ones(count, np.float32),
        track_position=np.zeros((count, 3), np.float32),
    )


def names_after(*updates, given=None):
    names = HypothesisNames(given)
    names.on_status(STATUS)
    for one in updates:
        names.on_update(one)
    return dict(names)


def test_a_body_is_called_by_the_link_that_moves_with_it():
    assert names_after(held(3, 2)) == {3: "elbow", 2: "tool"}
    # One that holds both has the name of the last.
    assert names_after(held(2, 2)) == {2: "tool"}


def test_what_rests_with_the_background_gives_it_no_name():
    found = held(1, 2)
    assert names_after(found) == {2: "tool"}
    # At first it is not known that it rests.
    soon = [replace(h, state="undetermined", born_ns=found.stamp_ns) for h in found.hypotheses]
    assert names_after(replace(found, hypotheses=soon)) == {}


def test_a_body_that_is_linked_to_one_with_a_name_has_it_too():
    found = held(3, 2)
    image = replace(found.hypotheses[3], space="door/pixels", linked=[2])
    found = replace(found, hypotheses=[*found.hypotheses[:3], image])
    assert names_after(found) == {3: "elbow", 2: "tool", image.id: "tool"}
    assert names_after(found, given={2: "door"})[image.id] == "door"


def test_a_name_stays_until_another_body_holds_the_feature():
    # The robot is late: no feature of it is in this update.
    late = replace(held(), hypotheses=held(3, 2).hypotheses)
    assert names_after(held(3, 2), late) == {3: "elbow", 2: "tool"}
    assert names_after(held(3, 2), held(2, 2)) == {2: "tool"}
    assert names_after(held(2, 2), held(2, 3)) == {2: "elbow", 3: "tool"}
    assert names_after(held(3, 2), held(3, 3)) == {3: "elbow"}


def test_what_a_person_gives_comes_first_and_ids_of_another_session_have_no_names():
    assert names_after(held(3, 2), given={2: "gripper"}) == {3: "elbow", 2: "gripper"}
    assert names_after(held(1, 2, session="1" * 16)) == {}
