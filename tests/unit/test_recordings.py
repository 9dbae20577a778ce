"""Readers of recordings, on files written here and, where set, on COMOTION_DATA."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from comotion_schemas import TruthBatch
from comotion_schemas.errors import RecordingError
from comotion_sources.recordings import read_recording, recording_streams
from comotion_sources.streams import batches

CORPUS = Path(__file__).parents[1] / "fuzz" / "corpus" / "c3d"
SCALE = 0.25


def some_positions(frames=40, markers=3):
    """Positions that 16-bit integers at the scale and float32 hold exactly, none at the origin."""
    rng = np.random.default_rng(1)
    return rng.integers(1, 8000, (frames, markers, 3)) * SCALE


def write_c3d(path, positions, *, lost=(), unit="mm", rate=50.0, scale=-1.0, **quantities):
    """Positions [F, N, 3] in a unit, as integers where `scale` is above 0.

    Pairs (frame, marker) of `lost` get a negative residual.
    """
    c3d = pytest.importorskip("c3d", reason="needs the extra mocap (c3d)")
    file = c3d.Writer(point_rate=rate, point_units=unit, point_scale=scale)
    for k, frame in enumerate(positions):
        points = np.zeros((len(frame), 5), np.float32)
        points[:, :3] = frame
        points[[marker for at, marker in lost if at == k], 3] = -1
        file.add_frames([(points, np.zeros((0, 0)))])
    names = {"LABELS": [f"M{k}" for k in range(positions.shape[1])]} | quantities
    for name, labels in names.items():
        file.point_group.add_str(name, "", *c3d.Writer.pack_labels(labels), len(labels))
    with path.open("wb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # there are no analog channels
        file.write(stream)
    return path


@pytest.mark.parametrize("scale", [-1.0, SCALE], ids=["real", "integer"])
def test_positions_of_c3d_are_metres_and_lost_markers_are_unseen(tmp_path, scale):
    positions = some_positions()
    positions[7, 2] = 0.0  # how some exporters write a marker that was not seen
    path = write_c3d(tmp_path / "take.c3d", positions, lost={(3, 0), (4, 0)}, scale=scale)
    recording = read_recording(path)
    expected = positions / 1000
    expected[3:5, 0] = expected[7, 2] = np.nan
    np.testing.assert_allclose(recording.positions, expected, rtol=1e-6)
    np.testing.assert_allclose(recording.times, np.arange(40) / 50)
    assert (recording.unit, recording.space, recording.dim) == ("m", "world", 3)
    assert recording.rate == pytest.approx(50.0)
    assert recording.labels is None


@pytest.mark.parametrize("processor", ["dec", "intel", "sgi"])
def test_every_processor_of_c3d_reads_the_same(tmp_path, processor):
    """The corpus holds the same four frames for each, as real numbers."""
    pytest.importorskip("c3d", reason="needs the extra mocap (c3d)")
    (tmp_path / "take.c3d").write_bytes((CORPUS / processor).read_bytes())
    recording = read_recording(tmp_path / "take.c3d")
    assert (recording.positions.shape, recording.rate) == ((4, 2, 3), pytest.approx(50.0))
    assert recording.positions[0].tolist() == [[0.9465, 1.02375, 1.51025], [1.90075, 0.06975, 0.2885]]


def test_angles_and_forces_among_the_points_are_left_out_and_texts_may_be_filled_with_zeros(tmp_path):
    positions = some_positions(markers=4)
    quantities = {"ANGLES": ["M1\0\0"], "FORCES": ["M3", "M9"]}
    path = write_c3d(tmp_path / "take.c3d", positions, unit="m\0\0\0", **quantities)
    np.testing.assert_allclose(read_recording(path).positions, positions[:, [0, 2]], rtol=1e-6)


def test_a_c3d_with_another_unit_or_no_rate_is_refused(tmp_path):
    positions = some_positions()
    with pytest.raises(RecordingError, match="its unit is 'furlong'"):
        read_recording(write_c3d(tmp_path / "a.c3d", positions, unit="furlong"))
    with pytest.raises(RecordingError, match="frame rate is 1e-06 Hz"):
        read_recording(write_c3d(tmp_path / "b.c3d", positions, rate=1e-6))


def write_npz(path, **changes):
    arrays = {
        "positions": np.arange(60.0).reshape(10, 3, 2),
        "times": 5.0 + np.arange(10) / 30,
        "labels": np.array([2, 0, 1]),
    } | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


def test_npz_in_two_dimensions_is_pixels(tmp_path):
    positions = np.arange(60.0).reshape(10, 3, 2)
    positions[4, 1, 0] = np.nan  # half a position is none
    positions[5, 1, 1] = np.inf
    names = np.array(["", "wall", "door"])
    recording = read_recording(write_npz(tmp_path / "take.npz", positions=positions, label_names=names))
    assert (recording.unit, recording.space, recording.dim) == ("px", "pixels", 2)
    assert np.isnan(recording.positions[4:6, 1]).all()
    assert np.isfinite(np.delete(recording.positions, 1, axis=1)).all()
    assert recording.times[0] == 0.0
    assert recording.rate == pytest.approx(30.0)
    assert recording.labels.tolist() == [2, -1, 1]
    assert recording.objects == {1: "wall", 2: "door"}


def test_npz_in_three_dimensions_is_metres(tmp_path):
    positions = np.arange(1.0, 91.0).reshape(10, 3, 3)
    names = {
        "segment_names": np.array(["arm", "hand"]),
        "units": np.array("mm"),
        "labels": np.array([-1, 1, 2]),
    }
    recording = read_recording(write_npz(tmp_path / "take.npz", positions=positions, **names))
    np.testing.assert_allclose(recording.positions, positions / 1000)
    assert recording.objects == {1: "arm", 2: "hand"}
    assert read_recording(write_npz(tmp_path / "x.npz", labels=None)).labels is None


def two_markers(tmp_path, rate=50.0):
    """Four markers for 2 s; marker 1 has a gap, marker 2 ends early, marker 3 is born late."""
    frames = round(2 * rate)
    positions = np.ones((frames, 4, 3)) * np.arange(frames)[:, None, None]
    positions[20:30, 1] = np.nan
    positions[60:, 2] = np.nan
    positions[:40, 3] = np.nan
    names = {"labels": np.array([1, 1, 2, -1]), "segment_names": np.array(["arm", "hand"])}
    path = write_npz(tmp_path / "take.npz", positions=positions, times=np.arange(frames) / rate, **names)
    return read_recording(path)


def test_gaps_births_and_ends_reach_the_batches(tmp_path):
    truths, observed = [], []
    for message in batches(recording_streams(two_markers(tmp_path)), epoch_ns=1_000):
        (truths if isinstance(message, TruthBatch) else observed).append(message)
    assert [batch.seq for batch in observed] == list(range(100))
    assert [batch.stamp_ns for batch in observed] == [1_000 + 20_000_000 * k for k in range(100)]
    assert [k for k, batch in enumerate(observed) if 1 not in batch.ids] == list(range(20, 30))
    assert [k for k, batch in enumerate(observed) if 3 in batch.ids] == list(range(40, 100))
    # Marker 2 is gone for good; marker 1 comes back, so it has not ended.
    ended = {k: batch.ended.tolist() for k, batch in enumerate(observed) if batch.ended is not None}
    assert ended == {60: [2]}
    assert [(t.ids.tolist(), t.objects.tolist(), t.names) for t in truths] == [
        ([0, 1, 2], [1, 1, 2], {"1": "arm", "2": "hand"}),
        ([3], [-1], {}),
    ]


def test_split_deals_markers_to_sources_of_different_rates(tmp_path):
    recording = two_markers(tmp_path)
    streams = recording_streams(recording, split=3)
    assert [stream.name for stream in streams] == ["replay-1", "replay-2", "replay-3"]
    assert [stream.rate for stream in streams] == pytest.approx([50.0, 25.0, 50 / 3])
    assert [len(list(stream)) for stream in streams] == [100, 50, 34]
    seen = [set().union(*(frame.ids.tolist() for frame in stream)) for stream in streams]
    assert seen == [{0, 3}, {1}, {2}]
    given = recording_streams(recording, split=2, rates=[40.0, 10.0], source="cam")
    assert [(s.name, s.rate, len(list(s))) for s in given] == [("cam-1", 40, 80), ("cam-2", 10, 20)]
    with pytest.raises(RecordingError, match="60 Hz exceeds the 50 Hz"):
        recording_streams(recording, rates=[60.0])
    with pytest.raises(ValueError, match="2 rates for 3 sources"):
        recording_streams(recording, split=3, rates=[10.0, 20.0])
