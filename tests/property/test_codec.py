"""The codec on random messages; tests/fuzz has damaged ones."""

import msgpack
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from comotion_schemas import (
    UNDETERMINED,
    Box,
    DecodeError,
    Event,
    Hypothesis,
    HypothesisUpdate,
    JointStates,
    ObservationBatch,
    Pose,
    Preview,
    SourceRef,
    Status,
    TruthBatch,
    Twist,
    decode,
    encode,
)

names = st.text("abcxyz019_-", min_size=1, max_size=64)
sessions = st.text("0123456789abcdef", min_size=16, max_size=16)
int64 = st.integers(-(2**63), 2**63 - 1)
uint64 = st.integers(0, 2**64 - 1)
hypothesis_ids = st.integers(0, UNDETERMINED - 1)
finite = st.floats(allow_nan=False, allow_infinity=False)
glyphs = st.characters(exclude_categories=("C", "Z"))
texts = st.text(glyphs, max_size=20)
spaces = st.text(glyphs, min_size=1, max_size=20)
float32 = st.floats(-(2.0**60), 2.0**60, width=32)


def floats(rows, width=None, elements=float32):
    return hnp.arrays(np.float32, (rows,) if width is None else (rows, width), elements=elements)


def unique_ids(count):
    return st.lists(uint64, min_size=count, max_size=count, unique=True).map(
        lambda ids: np.array(ids, np.uint64)
    )


@st.composite
def quaternions(draw, rows):
    values = draw(floats(rows, 4, st.floats(-1, 1, width=32)))
    norms = np.linalg.norm(values, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(norms > 1e-3, values / norms, np.nan)


@st.composite
def observation_batches(draw):
    rows, dim, stamp = draw(st.integers(0, 6)), draw(st.sampled_from([2, 3])), draw(int64)
    optional = {}
    if draw(st.booleans()):
        positive = st.floats(2.0**-60, 2.0**60, width=32)
        optional["sigma"] = draw(positive | floats(rows, None, positive))
    if dim == 3 and draw(st.booleans()):
        optional["quaternions"] = draw(quaternions(rows))
    if draw(st.booleans()):
        optional["ended"] = draw(unique_ids(draw(st.integers(0, 3))))
    if rows and draw(st.booleans()):
        stamps = np.array(draw(st.lists(st.integers(-(2**63), stamp), min_size=rows, max_size=rows)))
        stamps[0] = stamp
        optional["stamps_ns"] = stamps
    return ObservationBatch(
        source=draw(names),
        session=draw(sessions),
        seq=draw(uint64),
        space=draw(spaces),
        unit=draw(st.sampled_from(["m", "px"])),
        dim=dim,
        stamp_ns=stamp,
        ids=draw(unique_ids(rows)),
        positions=draw(floats(rows, dim)),
        **optional,
    )


@st.composite
def truth_batches(draw):
    rows = draw(st.integers(0, 6))
    return TruthBatch(
        source=draw(names),
        session=draw(sessions),
        ids=draw(unique_ids(rows)),
        objects=draw(hnp.arrays(np.int32, rows, elements=st.integers(-1, 2**31 - 1))),
        names={str(k): text for k, text in draw(st.dictionaries(st.integers(-1, 99), texts)).items()},
    )


@st.composite
def joint_states(draw):
    joints = draw(st.lists(texts, unique=True, max_size=5))
    column = hnp.arrays(np.float64, len(joints), elements=finite)
    return JointStates(
        source=draw(names),
        session=draw(sessions),
        seq=draw(uint64),
        stamp_ns=draw(int64),
        names=joints,
        positions=draw(column),
        velocities=draw(st.none() | column),
    )


@st.composite
def previews(draw):
    rows = draw(st.integers(0, 4))
    return Preview(
        source=draw(names),
        session=draw(sessions),
        stamp_ns=draw(int64),
        encoding="jpeg",
        image=draw(st.binary(max_size=50)),
        ids=draw(unique_ids(rows)),
        pixels=draw(floats(rows, 2)),
    )


statuses = st.builds(
    Status,
    component=names,
    role=st.sampled_from(["source", "service", "recorder", "viewer"]),
    session=sessions,
    stamp_ns=int64,
    state=st.sampled_from(["ok", "degraded", "stalled"]),
    rates=st.dictionaries(texts, finite, max_size=3),
    ages=st.dictionaries(texts, finite, max_size=3),
    counters=st.dictionaries(texts, uint64, max_size=3),
    rejected=st.dictionaries(st.sampled_from(["malformed", "too-large", "range"]), uint64),
    message=texts,
)


@st.composite
def hypotheses(draw, identity):
    dim, absent = draw(st.sampled_from([2, 3])), draw(st.none() | st.booleans())
    vector = st.lists(finite, min_size=dim, max_size=dim)
    half = st.lists(st.floats(0, 1e9), min_size=dim, max_size=dim)
    turn = finite if dim == 2 else st.lists(finite, min_size=3, max_size=3)
    rotation = finite if dim == 2 else st.sampled_from([[0.0, 0.0, 0.0, 1.0], [0.6, 0.0, 0.0, -0.8]])
    return Hypothesis(
        id=identity,
        space=draw(spaces),
        size=draw(uint64) if not absent else 0,
        born_ns=draw(int64),
        state=draw(st.sampled_from(["static", "moving", "undetermined"])),
        centroid=draw(vector),
        pose=draw(st.none() | st.builds(Pose, translation=vector, rotation=rotation)),
        twist=draw(st.none() | st.builds(Twist, linear=vector, angular=turn)),
        noise=draw(st.none() | st.floats(0, 1e9)),
        linked=draw(st.none() | st.lists(hypothesis_ids, max_size=3)),
        confirmed=draw(st.booleans()),
        absent=absent,
        box=draw(st.none() | st.builds(Box, center=vector, half=half, rotation=rotation)),
    )


@st.composite
def events(draw):
    several = {"split": (1, 1), "merged": (1, 3), "joined": (1, 3), "released": (1, 3)}
    kind = draw(st.sampled_from(["born", "ended", "absent", "returned", *several]))
    least, most = several.get(kind, (0, 0))
    others = draw(st.lists(hypothesis_ids, min_size=least, max_size=most))
    return Event(stamp_ns=draw(int64), kind=kind, hypothesis=draw(hypothesis_ids), others=others)


@st.composite
def hypothesis_updates(draw):
    sources = draw(st.lists(st.tuples(names, sessions), min_size=1, max_size=3, unique=True))
    identities = draw(st.lists(hypothesis_ids, unique=True, max_size=3))
    rows = draw(st.integers(0, 6))
    positions = draw(floats(rows, 3))
    if draw(st.booleans()):
        positions[:, 2] = np.nan
    owners = st.integers(0, len(sources) - 1)
    chosen = st.sampled_from([*identities, UNDETERMINED])
    return HypothesisUpdate(
        scene=draw(names),
        session=draw(sessions),
        seq=draw(uint64),
        stamp_ns=draw(int64),
        published_ns=draw(int64),
        period_ns=draw(st.integers(1, 2**63 - 1)),
        live=draw(st.booleans()),
        epoch=draw(uint64),
        sources=[SourceRef(name=name, session=session) for name, session in sources],
        track_source=draw(hnp.arrays(np.uint16, rows, elements=owners)),
        track_id=draw(unique_ids(rows)),
        track_hypothesis=draw(hnp.arrays(np.uint32, rows, elements=chosen)),
        track_confidence=draw(floats(rows, None, st.floats(0, 1, width=32))),
        track_position=positions,
        hypotheses=[draw(hypotheses(identity)) for identity in identities],
        events=draw(st.lists(events(), max_size=3)),
    )


messages = st.one_of(
    observation_batches(), truth_batches(), joint_states(), previews(), statuses, hypothesis_updates()
)


@settings(max_examples=150)
@given(messages)
def test_any_message_survives_the_wire(message):
    payload = encode(message)
    again = decode(payload)
    assert type(again) is type(message)
    assert encode(again) == payload
    for name, value in vars(message).items():
        other = getattr(again, name)
        if isinstance(value, np.ndarray):
            assert other.dtype == value.dtype
            np.testing.assert_array_equal(other, value)
        else:
            assert other == value


@settings(max_examples=150)
@given(messages, st.data())
def test_a_field_of_any_other_value_is_rejected_and_never_crashes(message, data):
    content = msgpack.unpackb(encode(message))
    value = st.recursive(
        st.none() | st.booleans() | int64 | uint64 | st.floats() | texts | st.binary(max_size=24),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
        max_leaves=6,
    )
    content[data.draw(st.sampled_from(sorted(content)))] = data.draw(value)
    try:
        again = decode(msgpack.packb(content))
    except DecodeError as error:
        assert error.reason  # noqa: PT017 - either outcome is right
        assert error.detail.isprintable()  # noqa: PT017
    else:
        assert decode(encode(again)) is not None
