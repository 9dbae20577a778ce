"""Tracks of other trackers: what CoTracker, TAPIR and others save is read, replayed and segmented."""

import csv
import json

import cv2
import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_schemas import ObservationBatch
from comotion_sources.recordings import read_recording, recording_streams
from comotion_sources.streams import batches

FRAMES, POINTS = 24, 60
MOVING = 25


@pytest.fixture(scope="module")
def scene():
    """Positions [T, N, 2] of 25 points that move to the right before others at rest, and which are seen."""
    rng = np.random.default_rng(0)
    places = rng.uniform([5, 5], [155, 115], (POINTS, 2))
    places[:MOVING] = rng.uniform([10, 30], [60, 90], (MOVING, 2))
    tracks = np.repeat(places[None], FRAMES, axis=0)
    tracks[:, :MOVING, 0] += 3.0 * np.arange(FRAMES)[:, None]
    tracks += rng.normal(0, 0.05, tracks.shape)
    seen = rng.uniform(size=(FRAMES, POINTS)) > 0.05
    return tracks, seen


# Arrays as the demos and predictors of a tracker give them.
FORMS = {
    "CoTracker": lambda x, seen: {"pred_tracks": x[None], "pred_visibility": seen[None, ..., None]},
    "CoTracker, renamed": lambda x, seen: {"tracks": x[None].astype(np.float32), "visibility": seen[None]},
    "TAPIR": lambda x, seen: {"tracks": x.swapaxes(0, 1), "visibles": seen.T},
    "TAPIR, as it leaves the network": lambda x, seen: {
        "tracks": x.swapaxes(0, 1)[None],
        "occlusion": np.where(seen.T, -4.0, 4.0)[None],
        "expected_dist": np.full((1, POINTS, FRAMES), -9.0),
    },
    "TAP-Vid": lambda x, seen: {"points": x.swapaxes(0, 1), "occluded": ~seen.T, "query_points": np.eye(3)},
    "PointOdyssey": lambda x, seen: {"trajs_2d": x, "visibs": seen},
    "points first": lambda x, seen: {"tracks": x.swapaxes(0, 1), "visibility": seen.T.astype(np.uint8)},
    "frames first, said by the times": lambda x, seen: {
        "tracks": x,
        "visibles": seen,
        "times": np.arange(FRAMES) / 10,
    },
}


@pytest.mark.parametrize("form", FORMS)
def test_every_tracker_gives_the_same_recording(scene, tmp_path, form):
    tracks, seen = scene
    np.savez(tmp_path / "apple.npz", **FORMS[form](tracks, seen))
    recording = read_recording(tmp_path / "apple.npz", 10.0)
    assert (recording.unit, recording.rate, len(recording)) == ("px", pytest.approx(10.0), FRAMES)
    np.testing.assert_allclose(recording.positions, np.where(seen[..., None], tracks, np.nan), rtol=1e-6)


def write_table(path, tracks, seen, **columns):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["frame", "track", "x", "y", "visibility", *columns])
        for k, n in np.ndindex(*seen.shape):
            values = [column[k, n] for column in columns.values()]
            rows.writerow([k + 7, 100 + n, *tracks[k, n], bool(seen[k, n]), *values])
    return path


def test_a_table_and_a_plain_array_are_read_too(scene, tmp_path):
    tracks, seen = scene
    table = read_recording(write_table(tmp_path / "apple.csv", tracks, seen), 10.0)
    np.testing.assert_allclose(table.positions, np.where(seen[..., None], tracks, np.nan))
    assert table.ids.tolist() == list(range(100, 100 + POINTS))
    np.save(tmp_path / "apple.npy", tracks)
    np.testing.assert_array_equal(read_recording(tmp_path / "apple.npy", 10.0).positions, tracks)


def test_confidence_is_noise_and_less_than_half_is_unseen(scene, tmp_path):
    tracks, seen = scene
    confidence = np.full(seen.shape, 1.0)
    confidence[:, 1], confidence[:, 2], confidence[:, 3] = 0.99, 0.7, 0.4
    np.savez(tmp_path / "a.npz", pred_tracks=tracks, pred_visibility=seen, confidence=confidence)
    recording = read_recording(tmp_path / "a.npz", 10.0)
    assert np.isnan(recording.positions[:, 3]).all()
    noise = [float(np.median(recording.sigma[seen[:, n], n])) for n in range(3)]
    assert 0.1 <= noise[0] < 0.2  # as the differences of its positions say
    assert 2 * noise[0] < noise[1] < noise[2] / 3
    observed = [m for m in batches(recording_streams(recording)) if isinstance(m, ObservationBatch)]
    shown = dict(zip(observed[5].ids.tolist(), observed[5].sigma.tolist(), strict=True))
    assert shown == pytest.approx({n: recording.sigma[5, n] for n in shown})
    assert 3 not in shown


def hypotheses_of(path):
    """Hypotheses at the end by track, of a table of `comotion segment`."""
    rows = list(csv.DictReader(path.read_text().splitlines()))
    last = max(int(row["frame"]) for row in rows)
    return {int(row["feature"]): row["hypothesis"] for row in rows if int(row["frame"]) == last}


def test_segment_groups_tracks_of_another_tracker(scene, tmp_path, capsys):
    tracks, seen = scene
    table = write_table(tmp_path / "apple.csv", tracks, seen)
    labelled = tmp_path / "labels.csv"
    assert run(["segment", "--tracks", str(table), "--fps", "10", "--csv", str(labelled), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary["duration_s"]) == (FRAMES, pytest.approx(2.3))
    labels = hypotheses_of(labelled)
    moving = {label for track, label in labels.items() if track < 100 + MOVING}
    resting = {label for track, label in labels.items() if track >= 100 + MOVING}
    assert len(moving) == len(resting) == 1
    assert moving != resting
    # Its own table is read again: what is tracked stays, what was found is left out.
    again = read_recording(labelled)
    assert again.positions.shape == (FRAMES, POINTS, 2)
    assert again.sigma is None


def test_segment_draws_tracks_on_the_frames_of_their_video(scene, tmp_path, capsys, caplog):
    tracks, seen = scene
    np.savez(tmp_path / "apple.npz", pred_tracks=tracks[:-4], pred_visibility=seen[:-4])
    (tmp_path / "images").mkdir()
    for k in range(FRAMES):
        cv2.imwrite(str(tmp_path / "images" / f"{k:04d}.png"), np.full((120, 160, 3), 200, np.uint8))
    out = tmp_path / "out"
    call = ["segment", str(tmp_path / "images"), "--tracks", str(tmp_path / "apple.npz"), "--rate", "10"]
    assert run([*call, "--out", str(out)]) == 0
    assert "apple has 20 frames, the video 24: the first 20 are used" in caplog.text
    drawn = sorted(out.iterdir())
    assert len(drawn) == FRAMES - 4
    assert cv2.imread(str(drawn[-1])).shape == (120, 160, 3)
    capsys.readouterr()
    np.savez(tmp_path / "room.npz", tracks_XYZ=np.ones((9, 4, 3)), fps=30)
    for words, reason in (
        ([*call, "--max-features", "9"], "--max-features is of our own tracker"),
        ([*call, "--fps", "9"], "has a rate of its own"),
        (["segment", "--tracks", str(tmp_path / "room.npz")], "in an image they are in px"),
    ):
        assert run(words) == 2
        assert reason in capsys.readouterr().err
