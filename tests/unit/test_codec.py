"""Every rejection of the codec with the reason the protocol names for it."""

from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest
from pydantic import ValidationError

from comotion_schemas import MAX_BYTES, DecodeError, decode, decode_on, encode

NAN, INF = float("nan"), float("inf")
ABSENT = object()


def u8(*values):
    return np.array(values, "<u8").tobytes()


def i8(*values):
    return np.array(values, "<i8").tobytes()


def f4(*values):
    return np.array(values, "<f4").tobytes()


def golden(name):
    """The map of a valid message."""
    path = Path(__file__).parents[1] / "golden" / f"{name}.msgpack"
    return msgpack.unpackb(path.read_bytes())


OBS = golden("observation-batch") | {"source": "cam", "stamp_ns": 50}
TRUTH, JOINTS, PREVIEW = golden("truth-batch"), golden("joint-states"), golden("preview")
STATUS, UPDATE = golden("status"), golden("hypothesis-update")
HYPOTHESES, (JOINT,) = UPDATE["hypotheses"], UPDATE["joints"]


def changed(content, **changes):
    return {key: value for key, value in (content | changes).items() if value is not ABSENT}


def hypothesis(**changes):
    return changed(UPDATE, hypotheses=[changed(HYPOTHESES[0], **changes), *HYPOTHESES[1:]])


def joints(*changes):
    return changed(UPDATE, joints=[changed(JOINT, **one) for one in changes])


def event(kind, others):
    return changed(UPDATE, events=[{"stamp_ns": 0, "kind": kind, "hypothesis": 4, "others": others}])


REJECTED = {
    # schema
    "no schema": (changed(OBS, schema=ABSENT), "schema"),
    "another version": (changed(OBS, schema="comotion.ObservationBatch/2"), "schema"),
    "a schema that is no string": (changed(OBS, schema=["comotion.ObservationBatch/1"]), "schema"),
    "a missing field": (changed(OBS, unit=ABSENT), "schema"),
    "a nil instead of an absent field": (changed(OBS, sigma=None), "schema"),
    "a name in capitals": (changed(OBS, source="Cam"), "schema"),
    "a name with a line feed": (changed(OBS, source="cam\n"), "schema"),
    "a name of 65 characters": (changed(OBS, source="c" * 65), "schema"),
    "a session of 15 digits": (changed(OBS, session=OBS["session"][1:]), "schema"),
    "another unit": (changed(OBS, unit="mm"), "schema"),
    "a number as float": (changed(OBS, seq=0.0), "schema"),
    "a boolean as number": (changed(OBS, dim=True), "schema"),
    "positions as list": (changed(OBS, positions=[[0, 1, 2], [3, 4, 5]]), "schema"),
    "sigma as string": (changed(OBS, sigma="0.1"), "schema"),
    "orientations in two dimensions": (
        changed(OBS, dim=2, positions=f4(1, 2, 3, 4), quaternions=f4(0, 0, 0, 1, 0, 0, 0, 1)),
        "schema",
    ),
    "a truth name for no number": (changed(TRUTH, names={"R": "R"}), "schema"),
    "another rejection reason": (changed(STATUS, rejected={"ugly": 1}), "schema"),
    "another event kind": (event("moved", []), "schema"),
    # unknown-field
    "an unknown field": (changed(OBS, colour="red"), "unknown-field"),
    "an unknown field of a hypothesis": (hypothesis(colour="red"), "unknown-field"),
    # length
    "an id cut short": (changed(OBS, ids=u8(1, 2)[:-1]), "length"),
    "too few positions": (changed(OBS, positions=f4(*range(5))), "length"),
    "too few stamps": (changed(OBS, stamps_ns=i8(50)), "length"),
    "too few sigmas": (changed(OBS, sigma=f4(1)), "length"),
    "too few quaternions": (changed(OBS, quaternions=f4(0, 0, 0, 1)), "length"),
    "an empty space name": (changed(OBS, space=""), "length"),
    "too few objects": (changed(TRUTH, objects=b""), "length"),
    "too few joints": (changed(JOINTS, positions=b""), "length"),
    "too few pixels": (changed(PREVIEW, pixels=b""), "length"),
    "a centroid of one": (hypothesis(centroid=[0.0]), "length"),
    "a pose of another dimension": (
        hypothesis(pose={"translation": [0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 1.0]}),
        "length",
    ),
    "a birth with others": (event("born", [1]), "length"),
    "a split from two": (event("split", [1, 2]), "length"),
    "a merger of none": (event("merged", []), "length"),
    "an absence with others": (event("absent", [1]), "length"),
    "an absent hypothesis with tracks": (hypothesis(absent=True), "range"),
    "an axis of another dimension": (joints({"axis": [1.0, 0.0]}), "length"),
    "a frame in two dimensions at once": (
        changed(UPDATE, frames={"cam": {"translation": [0.0, 0.0, 0.0], "rotation": 0.0}}),
        "length",
    ),
    # non-finite
    "a position that is NaN": (changed(OBS, positions=f4(0, 1, 2, 3, 4, NAN)), "non-finite"),
    "a sigma that is NaN": (changed(OBS, sigma=NAN), "non-finite"),
    "a quaternion that is partly NaN": (
        changed(OBS, quaternions=f4(0, 0, 0, 1, 0, 0, NAN, 1)),
        "non-finite",
    ),
    "an infinite rate": (changed(STATUS, rates={"obs": INF}), "non-finite"),
    "a joint that is NaN": (changed(JOINTS, positions=np.array([0, NAN]).tobytes()), "non-finite"),
    "a centroid that is NaN": (hypothesis(centroid=[0.0, 0.0, NAN]), "non-finite"),
    "a track position that is NaN": (changed(UPDATE, track_position=f4(1, NAN, *range(7))), "non-finite"),
    # duplicate-id
    "an id twice": (changed(OBS, ids=u8(7, 7)), "duplicate-id"),
    "an id twice in one instant": (changed(OBS, ids=u8(7, 7), stamps_ns=i8(50, 50)), "duplicate-id"),
    "an id that ended twice": (changed(OBS, ended=u8(3, 3)), "duplicate-id"),
    "a joint twice": (changed(JOINTS, names=["a", "a"]), "duplicate-id"),
    "a track twice": (changed(UPDATE, track_id=u8(3, 4, 4)), "duplicate-id"),
    "a hypothesis twice": (changed(UPDATE, hypotheses=[*HYPOTHESES, HYPOTHESES[0]]), "duplicate-id"),
    "a source twice": (changed(UPDATE, sources=UPDATE["sources"] * 2), "duplicate-id"),
    "two joints of a pair": (joints({}, {"parent": 3, "child": 1}), "duplicate-id"),
    "a joint with a stranger": (joints({"child": 6}), "range"),
    "a joint with itself": (joints({"child": 1}), "range"),
    "a joint with a long axis": (joints({"axis": [0.0, 0.0, 2.0]}), "range"),
    "a joint whose range is empty": (joints({"upper": -0.5}), "range"),
    "a joint in another space": (joints({"space": "other"}), "space-mismatch"),
    # range
    "a dimension of 4": (changed(OBS, dim=4), "range"),
    "a negative number": (changed(OBS, seq=-1), "range"),
    "a stamp beyond int64": (changed(OBS, stamp_ns=2**63), "range"),
    "a sigma of 0": (changed(OBS, sigma=0.0), "range"),
    "a sigma row below 0": (changed(OBS, sigma=f4(1, -1)), "range"),
    "a quaternion that is no rotation": (
        changed(OBS, quaternions=f4(0, 0, 0, 1, 0, 0, 0, 1.01)),
        "range",
    ),
    "stamps of which none is the newest": (changed(OBS, stamps_ns=i8(10, 20)), "range"),
    "stamps that decrease within an id": (
        changed(OBS, ids=u8(7, 7), stamps_ns=i8(50, 40)),
        "range",
    ),
    "an object below -1": (changed(TRUTH, objects=np.array([0, 1, -2], "<i4").tobytes()), "range"),
    "a period of 0": (changed(UPDATE, period_ns=0), "range"),
    "a track of no source": (changed(UPDATE, track_source=np.array([0, 1, 2], "<u2").tobytes()), "range"),
    "a track of no hypothesis": (
        changed(UPDATE, track_hypothesis=np.array([1, 2, 9], "<u4").tobytes()),
        "range",
    ),
    "a confidence above 1": (changed(UPDATE, track_confidence=f4(0, 1, 1.5)), "range"),
    "a hypothesis with the id of none": (hypothesis(id=2**32 - 1), "range"),
    "a noise below 0": (hypothesis(noise=-0.1), "range"),
    "a pose that is no rotation": (
        hypothesis(pose={"translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 0.5]}),
        "range",
    ),
    # malformed
    "a map key that is no string": ({1: 2}, "malformed"),
    "a list": ([1, 2], "malformed"),
    "a time of msgpack's own": (changed(OBS, stamp_ns=msgpack.Timestamp(1, 2)), "malformed"),
    # limit
    "a list that is too long": (changed(JOINTS, names=["a"] * 100_001), "malformed"),
    "too many containers": (
        changed(UPDATE, hypotheses=[[{}] * 90_000 for _ in range(6)]),
        "limit",
    ),
}


@pytest.mark.parametrize("name", list(REJECTED))
def test_rejected_with_its_reason(name):
    content, reason = REJECTED[name]
    with pytest.raises(DecodeError) as caught:
        decode(msgpack.packb(content))
    assert caught.value.reason == reason, caught.value.detail


NO_MAP = {
    "empty": b"",
    "unused byte": b"\xc1",
    "text": b"no msgpack at all",
    "truncated": msgpack.packb(OBS)[:-1],
    "trailing byte": msgpack.packb(OBS) + b"\0",
    "repeated key": b"\x82\xa1a\x01\xa1a\x02",
    "no UTF-8": b"\x81\xa2\xff\xfe\x01",
    "deep nesting": b"\x91" * 100_000,
    "map of 4 billion": b"\xdf\xff\xff\xff\xff",
    "bin of 4 GiB": b"\xc6\xff\xff\xff\xff",
}


@pytest.mark.parametrize("name", NO_MAP)
def test_bytes_that_are_no_map_are_malformed(name):
    with pytest.raises(DecodeError) as caught:
        decode(NO_MAP[name])
    assert caught.value.reason == "malformed"


def test_a_payload_above_16_mib_is_too_large_in_both_directions():
    with pytest.raises(DecodeError) as caught:
        decode(bytes(MAX_BYTES + 1))
    assert caught.value.reason == "too-large"
    preview = replace(decode(msgpack.packb(PREVIEW)), image=bytes(MAX_BYTES))
    with pytest.raises(ValueError, match="exceeds the limit"):
        encode(preview)


@pytest.mark.parametrize(
    ("key", "reason"),
    [
        ("comotion/@v1/lab/obs/cam", None),
        ("comotion/@v1/lab/obs/other", "source-mismatch"),
        ("comotion/@v1/lab/truth/cam", "schema"),
        ("comotion/@v1/lab/hypotheses", "schema"),
        ("comotion/@v1/lab/live/source/cam", "schema"),
    ],
)
def test_a_message_belongs_on_the_key_of_its_kind_and_publisher(key, reason):
    payload = encode(decode(msgpack.packb(OBS)))
    if reason is None:
        assert decode_on(key, payload).source == "cam"
        return
    with pytest.raises(DecodeError) as error:
        decode_on(key, payload)
    assert error.value.reason == reason


def test_the_detail_of_a_rejection_cannot_forge_output():
    with pytest.raises(DecodeError) as caught:
        decode(msgpack.packb(OBS | {"x\n\x1b[31mERROR {0} " + "y" * 9999: 1}))
    assert caught.value.detail.isprintable()
    assert len(caught.value.detail) < 600


@pytest.mark.parametrize(
    "arguments",
    [
        {"ids": [-1, 2]},
        {"ids": [True, False]},
        {"positions": [["0", "1", "2"], ["3", "4", "5"]]},
        {"positions": [[0, 1, 2], [3, 4, 1e39]]},
        {"positions": [[0, 1, 2], [3, 4]]},
    ],
)
def test_arrays_that_do_not_fit_are_refused_in_python_too(arguments):
    with pytest.raises(ValidationError):
        replace(decode(msgpack.packb(OBS)), **arguments)
