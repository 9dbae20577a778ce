"""Golden bytes of every message, in both directions.

The files were not made by the codec: ``python tests/golden/test_wire.py`` writes the messages below with
msgpack, their columns as the bytes of their numbers, as any other language would.
"""

from pathlib import Path

import msgpack
import numpy as np
import pytest

from comotion_schemas import (
    MESSAGE_TYPES,
    UNDETERMINED,
    Box,
    Event,
    Hypothesis,
    HypothesisUpdate,
    Joint,
    JointStates,
    ObservationBatch,
    Pose,
    Preview,
    Problem,
    SourceRef,
    Status,
    TruthBatch,
    Twist,
    decode,
    encode,
)

HERE = Path(__file__).parent
NAN = float("nan")
STAMP = 1_700_000_000_123_456_789
SESSION = "0123456789abcdef"


OBS = {"source": "cam-1", "session": SESSION, "seq": 7, "space": "world", "unit": "m", "dim": 3} | {
    "stamp_ns": STAMP
}

GOLDEN = {
    "observation-batch": ObservationBatch(
        **OBS, ids=[3, 2**64 - 1], positions=[[0.5, -1.0, 2.0], [0.0, 0.25, -8.0]]
    ),
    "observation-batch-empty": ObservationBatch(**OBS, ids=[], positions=[]),
    "observation-batch-full": ObservationBatch(
        **OBS,
        ids=[5, 5, 6],
        positions=[[1, 2, 3], [4, 5, 6], [7, 8, 9]],
        stamps_ns=[STAMP - 10, STAMP, STAMP - 5],
        sigma=[0.5, 0.5, 0.25],
        quaternions=[[0, 0, 0, 1], [0, 0, 1, 0], [NAN, NAN, NAN, NAN]],
        ended=[1, 2],
    ),
    "observation-batch-pixels": ObservationBatch(
        **OBS | {"space": "klt-left/pixels", "unit": "px", "dim": 2},
        ids=[0],
        positions=[[639.5, 479.5]],
        sigma=0.5,
    ),
    "truth-batch": TruthBatch(
        source="sim",
        session=SESSION,
        ids=[1, 2, 9],
        objects=[0, -1, 3],
        names={"0": "R", "3": "Schrank ä"},
    ),
    "joint-states": JointStates(
        source="arm",
        session=SESSION,
        seq=0,
        stamp_ns=STAMP,
        names=["j1", "j2"],
        positions=[0.1, -3.0],
        velocities=[0.0, 1e-9],
    ),
    "preview": Preview(
        source="cam-1",
        session=SESSION,
        stamp_ns=STAMP,
        encoding="jpeg",
        image=b"\xff\xd8\xff\xd9",
        ids=[4],
        pixels=[[12.5, 7.25]],
    ),
    "hypothesis-update": HypothesisUpdate(
        scene="default",
        session=SESSION,
        seq=12,
        stamp_ns=STAMP,
        published_ns=STAMP + 500,
        period_ns=100_000_000,
        live=False,
        epoch=3,
        sources=[SourceRef(name="cam-1", session=SESSION), SourceRef(name="cam-2", session="f" * 16)],
        track_source=[0, 1, 1],
        track_id=[3, 3, 4],
        track_hypothesis=[1, 2, UNDETERMINED],
        track_confidence=[1.0, 0.5, 0.0],
        track_position=[[1, 2, 3], [4, 5, NAN], [6, 7, 8]],
        hypotheses=[
            Hypothesis(
                id=1,
                space="world",
                size=1,
                born_ns=STAMP - 1,
                state="moving",
                centroid=[1.0, 2.0, 3.0],
                pose=Pose(translation=[0.5, 0.0, 0.0], rotation=[0.0, 0.0, 0.0, 1.0]),
                twist=Twist(linear=[0.0, 0.0, 0.25], angular=[0.0, 0.0, -1.0]),
                noise=0.003,
                linked=[2],
                box=Box(center=[1.0, 2.0, 3.0], half=[0.5, 0.25, 0.0], rotation=[0.0, 0.0, 0.0, 1.0]),
            ),
            Hypothesis(
                id=2,
                space="cam-2/pixels",
                size=1,
                born_ns=0,
                state="static",
                centroid=[4.0, 5.0],
                pose=Pose(translation=[0.0, 0.0], rotation=0.5),
                twist=Twist(linear=[0.0, 0.0], angular=0.0),
                confirmed=False,
            ),
            Hypothesis(
                id=3,
                space="world",
                size=0,
                born_ns=0,
                state="moving",
                centroid=[4.0, 5.0, 6.0],
                absent=True,
            ),
        ],
        events=[
            Event(stamp_ns=STAMP, kind="split", hypothesis=2, others=[1]),
            Event(stamp_ns=STAMP, kind="ended", hypothesis=7, others=[]),
            Event(stamp_ns=STAMP, kind="absent", hypothesis=3, others=[]),
            Event(stamp_ns=STAMP, kind="joined", hypothesis=1, others=[3]),
        ],
        joints=[
            Joint(
                parent=1,
                child=3,
                space="world",
                kind="revolute",
                confidence=0.875,
                axis=[0.0, 0.0, 1.0],
                point=[0.5, 0.25, 0.0],
                position=0.75,
                rate=-0.5,
                lower=0.0,
                upper=1.5,
                sigma_axis=0.01,
                sigma_point=0.002,
                sigma_position=0.005,
                sigma_rate=0.1,
            ),
        ],
        frames={"world": Pose(translation=[0.0, 0.0, 1.0], rotation=[0.0, 0.0, 1.0, 0.0])},
    ),
    "status": Status(
        component="fusion",
        role="service",
        session=SESSION,
        stamp_ns=STAMP,
        state="degraded",
        rates={"updates": 10.0},
        ages={"cam-1": 0.25},
        counters={"batches": 3, "late": 0},
        rejected={"too-large": 1},
        message="cam-2 is stalled",
        version="0.1.0",
        host="server-1",
        replica="active",
        epoch=42,
        clock_offsets={"cam-1": -0.0125},
        problems=[
            Problem(source="cam-2", kind="silent", since_ns=STAMP, text="cam-2: no data for 4 s"),
            Problem(kind="limit", since_ns=STAMP, text="256 spaces are in use"),
        ],
    ),
}


def plain(value):
    """Nested dicts, lists and numbers; NaN as a string, so that it equals itself."""
    if isinstance(value, np.ndarray):
        return [str(value.dtype), value.shape, plain(value.tolist())]
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return "nan" if isinstance(value, float) and np.isnan(value) else value


def written(value):
    """What another language would give to msgpack for a message or a part of it."""
    if isinstance(value, list):
        return [written(item) for item in value]
    if isinstance(value, dict):
        return {key: written(item) for key, item in value.items()}
    if not hasattr(value, "__dataclass_fields__"):
        return value
    fields = {}
    for name in value.__dataclass_fields__:
        item = getattr(value, name)
        if isinstance(item, np.ndarray):
            item = item.astype(item.dtype.newbyteorder("<")).tobytes()
        if item is not None:
            fields[name] = written(item)
    return fields


def test_every_message_type_is_there():
    assert {type(message) for message in GOLDEN.values()} == set(MESSAGE_TYPES)
    assert {path.stem for path in HERE.glob("*.msgpack")} == set(GOLDEN)


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_a_message_encodes_to_the_golden_bytes(name):
    assert encode(GOLDEN[name]) == (HERE / f"{name}.msgpack").read_bytes()


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_the_golden_bytes_decode_to_the_message(name):
    message = decode((HERE / f"{name}.msgpack").read_bytes())
    assert type(message) is type(GOLDEN[name])
    assert plain(message) == plain(GOLDEN[name])


def write() -> None:
    for name, message in GOLDEN.items():
        (HERE / f"{name}.msgpack").write_bytes(msgpack.packb(written(message)))


if __name__ == "__main__":
    write()
