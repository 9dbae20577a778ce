"""`comotion segment`: labels of every frame, dense regions, and a real video with labels drawn by hand."""

import csv
import json

import cv2
import numpy as np
import pytest

from comotion_clients.regions import regions
from comotion_deploy.cli import run
from comotion_experiments.contact_sheet import LIMIT
from comotion_experiments.labelled import Labelled
from comotion_experiments.masks import MaskFolder
from comotion_schemas.colours import COLOURS
from comotion_sources.cameras.types import Frame
from comotion_sources.klt.tracker import Tracks

from ..pictures import moving_board

FRAMES, SHAPE = 24, (120, 160)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Images at 10 Hz of a patch that moves to the right before a background at rest."""
    path = tmp_path_factory.mktemp("images")
    for k in range(FRAMES):
        cv2.imwrite(str(path / f"{k:04d}.png"), moving_board(k, SHAPE)[0])
    return path


def segment(folder, *arguments):
    assert run(["segment", str(folder), "--rate", "10", "--max-features", "60", *map(str, arguments)]) == 0


def test_every_frame_is_labelled_the_same_on_every_run(folder, tmp_path, capsys):
    summaries = []
    for name in ("a.csv", "b.csv"):
        segment(folder, "--csv", tmp_path / name, "--json")
        summaries.append(json.loads(capsys.readouterr().out))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert summaries[0]["labels_sha256"] == summaries[1]["labels_sha256"]
    assert summaries[0]["frames"] == FRAMES
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert list(rows[0]) == ["frame", "time", "feature", "x", "y", "hypothesis", "confidence"]
    assert sorted({int(row["frame"]) for row in rows}) == list(range(FRAMES))
    assert {float(row["time"]) for row in rows if row["frame"] == "10"} == {1.0}
    last = [row for row in rows if row["frame"] == str(FRAMES - 1)]
    left = 20 + 3 * (FRAMES - 1)
    places = [(float(row["x"]), float(row["y"]), row["hypothesis"]) for row in last]
    inside = [one for x, y, one in places if left + 8 < x < left + 52 and 38 < y < 82]
    outside = [one for x, _, one in places if x < left - 10]
    assert len(set(inside)) == len(set(outside)) == 1
    assert set(inside) != set(outside)


def test_the_video_is_what_browsers_play_and_bodies_have_colours(folder, tmp_path, capsys):
    av = pytest.importorskip("av")
    segment(folder, "--out", tmp_path / "out.mp4")
    printed = capsys.readouterr().out
    assert f"{FRAMES} frames" in printed
    assert "out.mp4" in printed
    with av.open(str(tmp_path / "out.mp4")) as video:
        stream = video.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        images = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert len(images) == FRAMES
    away = [np.abs(images[-1].astype(int) - rgb).max(axis=2) for rgb in COLOURS]
    assert max(int((one < 40).sum()) for one in away) > 50


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


def picture():
    """A bright disc on a dark ground, and where the disc is."""
    y, x = np.mgrid[0:120, 0:160]
    disc = (x - 90) ** 2 + (y - 50) ** 2 < 30**2
    rng = np.random.default_rng(0)
    image = np.where(disc, 180, 60)[..., None] + rng.normal(0, 6, (120, 160, 3))
    return image.clip(0, 255).astype(np.uint8), disc


def features(disc, count):
    """Pixels of features anywhere, and their labels: 7 on the disc, else 3."""
    pixels = np.random.default_rng(1).uniform([0, 0], [159, 119], (count, 2)).astype(np.float32)
    return pixels, np.where(disc[pixels[:, 1].astype(int), pixels[:, 0].astype(int)], 7, 3)


def overlap(one, other):
    """Intersection over union of two masks."""
    return (one & other).sum() / (one | other).sum()


def test_regions_end_at_the_edges_of_the_image():
    image, disc = picture()
    pixels, labels = features(disc, 60)
    labels[:5] = -1
    dense = regions(image, pixels, labels)
    assert set(np.unique(dense)) == {3, 7}
    assert overlap(dense == 3, ~disc) > 0.95
    assert overlap(dense == 7, disc) > 0.9


def test_a_body_does_not_spread_over_a_wall_without_edges():
    on_body = np.random.default_rng(0).uniform([14, 44], [46, 76], (20, 2))
    pixels = np.vstack([on_body, [[155, 4], [155, 60], [115, 115]]]).astype(np.float32)
    dense = regions(np.full((120, 160), 90, np.uint8), pixels, np.repeat([7, 3], [20, 3]))
    assert (dense[:, 80:] == 3).all()


def test_a_wall_with_few_features_at_its_ends_is_the_background():
    image, disc = picture()
    on_disc = np.argwhere(disc)[::7, ::-1]
    wall = [[x + dx, y + dy] for x in (4, 150) for y in (4, 110) for dx in (0, 4) for dy in (0, 4)]
    pixels = np.vstack([wall, on_disc]).astype(np.float32)
    dense = regions(image, pixels, np.repeat([3, 7], [len(wall), len(on_disc)]))
    assert overlap(dense == 7, disc) > 0.9


def test_masks_hold_the_hypothesis_of_every_pixel(tmp_path):
    image, _ = picture()
    pixels = np.array([[5, 5], [90, 50]], np.float32)
    labels = np.array([1, 300])
    tracks = Tracks(**dict.fromkeys(Tracks.__dataclass_fields__) | {"pixels": pixels})
    folder = MaskFolder(tmp_path / "masks", 0.5)
    for k in range(7):
        frame = Frame(k * 100_000_000, image)
        folder.write(Labelled(k, frame, tracks, labels, np.ones(2), []))
    assert sorted(path.name for path in (tmp_path / "masks").iterdir()) == ["000000.png", "000005.png"]
    mask = cv2.imread(str(tmp_path / "masks" / "000005.png"), cv2.IMREAD_UNCHANGED)
    assert mask.dtype == np.uint16
    assert (mask == regions(image, pixels, labels)).all()


def test_a_sheet_is_written_alone(folder, tmp_path, capsys):
    segment(folder, "--sheet", tmp_path / "sheet.jpg")
    assert f"wrote {tmp_path / 'sheet.jpg'}" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sheet.jpg"]
    page = cv2.imread(str(tmp_path / "sheet.jpg"))
    assert page.shape == (4 * SHAPE[0], 3 * SHAPE[1], 3)
    assert (tmp_path / "sheet.jpg").stat().st_size <= LIMIT
    # A hypothesis that moves is drawn in a colour; the images and what rests are grey.
    assert (np.ptp(page.astype(int), axis=2) > 80).any()
