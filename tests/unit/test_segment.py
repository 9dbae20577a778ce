"""`comotion segment`: every frame, the same labels on every run, a table, a picture and a summary."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_experiments.contact_sheet import LIMIT, ContactSheet
from comotion_schemas.colours import COLOURS

FRAMES, SHAPE = 24, (120, 160)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Images at 10 Hz of a patch that moves to the right before a background at rest."""
    path = tmp_path_factory.mktemp("images")
    rng = np.random.default_rng(0)
    texture = [cv2.GaussianBlur(rng.integers(0, 255, SHAPE, np.uint8), (0, 0), 1.5) * 2 for _ in range(2)]
    for k in range(FRAMES):
        image = texture[0].copy()
        image[30:90, 10 + 3 * k : 70 + 3 * k] = texture[1][30:90, 10:70]
        cv2.imwrite(str(path / f"{k:04d}.png"), image)
    return path


def segment(folder: Path, *arguments: object) -> None:
    assert run(["segment", str(folder), "--rate", "10", "--max-features", "60", *map(str, arguments)]) == 0


def test_every_frame_is_labelled_the_same_on_every_run(folder, tmp_path, capsys):
    found = []
    for name in ("a.csv", "b.csv"):
        segment(folder, "--csv", tmp_path / name, "--json")
        found.append(json.loads(capsys.readouterr().out))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert found[0]["labels_sha256"] == found[1]["labels_sha256"]
    assert found[0]["frames"] == FRAMES
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert list(rows[0]) == ["frame", "time", "feature", "x", "y", "hypothesis", "confidence"]
    assert sorted({int(row["frame"]) for row in rows}) == list(range(FRAMES))
    assert {float(row["time"]) for row in rows if row["frame"] == "10"} == {1.0}
    last = [row for row in rows if row["frame"] == str(FRAMES - 1)]
    left = 10 + 3 * (FRAMES - 1)
    inside = [
        row["hypothesis"]
        for row in last
        if left + 8 < float(row["x"]) < left + 52 and 38 < float(row["y"]) < 82
    ]
    outside = [row["hypothesis"] for row in last if float(row["x"]) < left - 10]
    assert len(set(inside)) == len(set(outside)) == 1
    assert set(inside) != set(outside)


def test_the_video_is_what_browsers_play_and_bodies_have_colours(folder, tmp_path, capsys):
    av = pytest.importorskip("av")
    segment(folder, "--out", tmp_path / "out.mp4")
    said = capsys.readouterr().out
    assert f"{FRAMES} frames" in said
    assert "out.mp4" in said
    with av.open(str(tmp_path / "out.mp4")) as video:
        stream = video.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        images = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert len(images) == FRAMES
    away = [np.abs(images[-1].astype(int) - rgb).max(axis=2) for rgb in COLOURS]
    assert max(int((one < 40).sum()) for one in away) > 50


def test_a_body_is_drawn_by_the_name_that_it_is_given(folder, tmp_path):
    for out, names in (("ids", ()), ("named", ("--name", "2=drawer"))):
        segment(folder, "--out", tmp_path / out, *names)
    plain, called = (cv2.imread(str(max((tmp_path / out).glob("*.png")))) for out in ("ids", "named"))
    assert (plain != called).any()


def test_frames_of_an_earlier_run_are_not_mixed_with_new_ones(folder, tmp_path, capsys):
    out = tmp_path / "frames"
    out.mkdir()
    (out / "000900.png").write_bytes(b"an old frame")
    (out / "mine.png").write_bytes(b"not a frame")
    assert run(["segment", str(folder), "--out", str(out)]) == 2
    assert "1 frame of an earlier run: --overwrite removes them" in capsys.readouterr().err
    segment(folder, "--out", out, "--overwrite")
    assert sorted(path.name for path in out.iterdir()) == [
        *(f"{k:06d}.png" for k in range(FRAMES)),
        "mine.png",
    ]


@pytest.mark.parametrize("count", [1, 5, 12, 60, 500, 5000])
def test_a_sheet_shows_the_whole_video_at_equal_distances(count: int) -> None:
    sheet, image = ContactSheet(), np.zeros((24, 48, 3), np.uint8)
    for number in range(count):
        sheet.add(image, float(number))
    times = np.array([seconds for seconds, _ in sheet.shown])
    assert len(times) == min(count, 12)
    assert times[-1] >= 0.95 * (count - 1)
    steps = np.diff(times, prepend=-1)
    assert steps.max() - steps.min() <= max(1, 0.1 * count / 12 * 2)


def test_a_sheet_is_written_alone(folder, tmp_path, capsys) -> None:
    segment(folder, "--sheet", tmp_path / "sheet.jpg")
    assert f"wrote {tmp_path / 'sheet.jpg'}" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sheet.jpg"]
    page = cv2.imread(str(tmp_path / "sheet.jpg"))
    assert page.shape == (4 * SHAPE[0], 3 * SHAPE[1], 3)
    assert (tmp_path / "sheet.jpg").stat().st_size <= LIMIT
    # A hypothesis that moves is drawn in a colour; the images and what rests are grey.
    assert (np.ptp(page.astype(int), axis=2) > 80).any()
