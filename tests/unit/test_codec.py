"""Every rejection of the codec with its reason; keys, quality of service and schemas of the protocol."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import msgpack
import numpy as np
import pytest
from jsonschema import Draft202012Validator
from pydantic import ValidationError

from comotion_schemas import MAX_BYTES, MESSAGE_TYPES, QOS, DecodeError, Keys, decode, decode_on, encode
from comotion_schemas.export import files, json_schemas

NAN, INF = float("nan"), float("inf")
ABSENT = object()


def column(kind, *values):
    return np.array(values, kind).tobytes()


u8, i8, f4 = (partial(column, kind) for kind in ("<u8", "<i8", "<f4"))


def golden(name):
    """The map of a valid message."""
    path = Path(__file__).parents[1] / "golden" / f"{name}.msgpack"
    return msgpack.unpackb(path.read_bytes())


def changed(content, **changes):
    return {key: value for key, value in (content | changes).items() if value is not ABSENT}


OBS, UPDATE = golden("observation-batch") | {"source": "cam", "stamp_ns": 50}, golden("hypothesis-update")
HYPOTHESES, (JOINT,) = UPDATE["hypotheses"], UPDATE["joints"]
obs, update = partial(changed, OBS), partial(changed, UPDATE)
truth, joint_states, preview, status = (
    partial(changed, golden(name)) for name in ("truth-batch", "joint-states", "preview", "status")
)
TURN = 0, 0, 0, 1


def hypothesis(**changes):
    return update(hypotheses=[changed(HYPOTHESES[0], **changes), *HYPOTHESES[1:]])


def joints(*changes):
    return update(joints=[changed(JOINT, **fields) for fields in changes])


def event(kind, others):
    return update(events=[{"stamp_ns": 0, "kind": kind, "hypothesis": 4, "others": others}])


REJECTED = {
    "schema": {
        "no schema": obs(schema=ABSENT),
        "another version": obs(schema="comotion.ObservationBatch/2"),
        "a schema that is no string": obs(schema=["comotion.ObservationBatch/1"]),
        "a missing field": obs(unit=ABSENT),
        "a nil instead of an absent field": obs(sigma=None),
        "a name in capitals": obs(source="Cam"),
        "a name with a line feed": obs(source="cam\n"),
        "a name of 65 characters": obs(source="c" * 65),
        "a session of 15 digits": obs(session=OBS["session"][1:]),
        "another unit": obs(unit="mm"),
        "a number as float": obs(seq=0.0),
        "a boolean as number": obs(dim=True),
        "positions as list": obs(positions=[[0, 1, 2], [3, 4, 5]]),
        "sigma as string": obs(sigma="0.1"),
        "orientations in two dimensions": obs(dim=2, positions=f4(1, 2, 3, 4), quaternions=f4(*TURN, *TURN)),
        "a truth name for no number": truth(names={"R": "R"}),
        "another rejection reason": status(rejected={"ugly": 1}),
        "another event kind": event("moved", []),
    },
    "unknown-field": {
        "an unknown field": obs(colour="red"),
        "an unknown field of a hypothesis": hypothesis(colour="red"),
    },
    "length": {
        "an id cut short": obs(ids=u8(1, 2)[:-1]),
        "too few positions": obs(positions=f4(*range(5))),
        "too few stamps": obs(stamps_ns=i8(50)),
        "too few sigmas": obs(sigma=f4(1)),
        "too few quaternions": obs(quaternions=f4(*TURN)),
        "an empty space name": obs(space=""),
        "too few objects": truth(objects=b""),
        "too few joints": joint_states(positions=b""),
        "too few pixels": preview(pixels=b""),
        "a centroid of one": hypothesis(centroid=[0.0]),
        "a pose of another dimension": hypothesis(
            pose={"translation": [0.0, 0.0], "rotation": [*map(float, TURN)]}
        ),
        "a birth with others": event("born", [1]),
        "a split from two": event("split", [1, 2]),
        "a merger of none": event("merged", []),
        "an absence with others": event("absent", [1]),
        "an axis of another dimension": joints({"axis": [1.0, 0.0]}),
        "a frame in two dimensions at once": update(
            frames={"cam": {"translation": [0.0, 0.0, 0.0], "rotation": 0.0}}
        ),
    },
    "range": {
        "an absent hypothesis with tracks": hypothesis(absent=True),
        "a joint with a stranger": joints({"child": 6}),
        "a joint with itself": joints({"child": 1}),
        "a joint with a long axis": joints({"axis": [0.0, 0.0, 2.0]}),
        "a joint whose range is empty": joints({"upper": -0.5}),
        "a dimension of 4": obs(dim=4),
        "a negative number": obs(seq=-1),
        "a stamp beyond int64": obs(stamp_ns=2**63),
        "a sigma of 0": obs(sigma=0.0),
        "a sigma row below 0": obs(sigma=f4(1, -1)),
        "a quaternion that is no rotation": obs(quaternions=f4(*TURN, 0, 0, 0, 1.01)),
        "stamps of which none is the newest": obs(stamps_ns=i8(10, 20)),
        "stamps that decrease within an id": obs(ids=u8(7, 7), stamps_ns=i8(50, 40)),
        "an object below -1": truth(objects=np.array([0, 1, -2], "<i4").tobytes()),
        "a period of 0": update(period_ns=0),
        "a track of no source": update(track_source=np.array([0, 1, 2], "<u2").tobytes()),
        "a track of no hypothesis": update(track_hypothesis=np.array([1, 2, 9], "<u4").tobytes()),
        "a confidence above 1": update(track_confidence=f4(0, 1, 1.5)),
        "a hypothesis with the id of none": hypothesis(id=2**32 - 1),
        "a noise below 0": hypothesis(noise=-0.1),
        "a pose that is no rotation": hypothesis(
            pose={"translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 0.5]}
        ),
    },
    "non-finite": {
        "a position that is NaN": obs(positions=f4(0, 1, 2, 3, 4, NAN)),
        "a sigma that is NaN": obs(sigma=NAN),
        "a quaternion that is partly NaN": obs(quaternions=f4(*TURN, 0, 0, NAN, 1)),
        "an infinite rate": status(rates={"obs": INF}),
        "a joint that is NaN": joint_states(positions=np.array([0, NAN]).tobytes()),
        "a centroid that is NaN": hypothesis(centroid=[0.0, 0.0, NAN]),
        "a track position that is NaN": update(track_position=f4(1, NAN, *range(7))),
    },
    "duplicate-id": {
        "an id twice": obs(ids=u8(7, 7)),
        "an id twice in one instant": obs(ids=u8(7, 7), stamps_ns=i8(50, 50)),
        "an id that ended twice": obs(ended=u8(3, 3)),
        "a joint twice": joint_states(names=["a", "a"]),
        "a track twice": update(track_id=u8(3, 4, 4)),
        "a hypothesis twice": update(hypotheses=[*HYPOTHESES, HYPOTHESES[0]]),
        "a source twice": update(sources=UPDATE["sources"] * 2),
        "two joints of a pair": joints({}, {"parent": 3, "child": 1}),
    },
    "space-mismatch": {"a joint in another space": joints({"space": "other"})},
    "malformed": {
        "a map key that is no string": {1: 2},
        "a list": [1, 2],
        "a time of msgpack's own": obs(stamp_ns=msgpack.Timestamp(1, 2)),
        "a list that is too long": joint_states(names=["a"] * 100_001),
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
    },
    "limit": {"too many containers": update(hypotheses=[[{}] * 90_000 for _ in range(6)])},
}


@pytest.mark.parametrize(
    ("reason", "name"), [(reason, name) for reason, of in REJECTED.items() for name in of]
)
def test_rejected_with_its_reason(reason, name):
    content = REJECTED[reason][name]
    with pytest.raises(DecodeError) as caught:
        decode(content if isinstance(content, bytes) else msgpack.packb(content))
    assert caught.value.reason == reason, caught.value.detail


def test_a_payload_above_16_mib_is_too_large_in_both_directions():
    with pytest.raises(DecodeError) as caught:
        decode(bytes(MAX_BYTES + 1))
    assert caught.value.reason == "too-large"
    large = replace(decode(msgpack.packb(preview())), image=bytes(MAX_BYTES))
    with pytest.raises(ValueError, match="exceeds the limit"):
        encode(large)


@pytest.mark.parametrize(
    ("key", "reason"),
    [
        ("comotion/@v1/lab/obs/cam", None),
        ("comotion/@v1/lab/obs/other", "source-mismatch"),
        ("comotion/@v1/lab/truth/cam", "schema"),
        ("comotion/@v1/lab/hypotheses", "schema"),
        ("comotion/@v1/lab/live/source/cam", "schema"),
        ("comotion/@v1/lab/other/cam", "schema"),
        ("comotion/@v2/lab/obs/cam", "schema"),
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


def test_keys_are_those_of_the_protocol():
    keys = Keys("lab")
    assert Keys().prefix == "comotion/@v1/default"
    assert keys.stream("obs", "cam-1") == "comotion/@v1/lab/obs/cam-1"
    assert keys.streams("truth") == "comotion/@v1/lab/truth/*"
    assert keys.hypotheses == "comotion/@v1/lab/hypotheses"
    assert keys.live("source", "cam-1") == "comotion/@v1/lab/live/source/cam-1"
    assert keys.all_live() == "comotion/@v1/lab/live/*/*"
    assert keys.query("affinity") == "comotion/@v1/lab/query/affinity"


@pytest.mark.parametrize("name", ["", "A", "a/b", "a b", "ä", "a\n", "*", "$*", "@v1", "x" * 65])
def test_a_name_is_one_chunk_of_plain_characters(name):
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys(name)
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys().stream("obs", name)
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys().live("source", name)


def test_every_message_has_one_quality_of_service():
    assert sorted(qos.message for qos in QOS.values()) == sorted(kind.__name__ for kind in MESSAGE_TYPES)
    assert QOS["obs"].encoding == "application/msgpack;comotion.ObservationBatch/1"
    # A late joiner gets the last update and all truths, but no observations of the past.
    assert QOS["hypotheses"].cache == 1
    assert QOS["truth"].cache > 1000
    assert QOS["obs"].cache == 0


ROOT = Path(__file__).parents[2]


def test_the_committed_schemas_are_current():
    assert {path.name: path.read_text() for path in ROOT.glob("schemas/*.schema.json")} == files()


@pytest.mark.parametrize("kind", MESSAGE_TYPES, ids=lambda kind: kind.__name__)
def test_a_schema_is_valid_and_names_every_field(kind):
    schema = json_schemas()[kind.__name__]
    Draft202012Validator.check_schema(schema)
    assert list(schema["properties"]) == list(kind.__dataclass_fields__)
    assert "\\z" not in str(schema)
    assert "null" not in str(schema)
