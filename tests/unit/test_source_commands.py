"""``comotion source``: a known error is one line and exit 2, before any router is looked for."""

import shlex

import cv2
import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_sources import replay
from comotion_sources.calibration import Intrinsics, format_calibration
from comotion_sources.simulator import scene_names

from ..command_line import refused


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the files that the commands name."""
    folder = tmp_path_factory.mktemp("files")
    np.savez(folder / "take.npz", positions=np.ones((50, 4, 3)), times=np.arange(50) / 50)
    (folder / "cut.npz").write_bytes((folder / "take.npz").read_bytes()[:500])
    (folder / "empty.npz").touch()
    (folder / "text.c3d").write_text("x" * 2000)
    video = cv2.VideoWriter(str(folder / "video.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (320, 240))
    video.write(np.zeros((240, 320, 3), np.uint8))
    video.release()
    (folder / "wrong.yaml").write_text("image_width: 320\n")
    inner = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    (folder / "inner.toml").write_text(format_calibration(inner, None))
    return folder


WRONG = [
    ("simulator", "which scene"),
    ("simulator fig9", "no scene 'fig9'"),
    ("simulator fig4_4 --part 4/3", "part '4/3'"),
    ("simulator fig4_4 --rate 0", "rate '0'"),
    ("simulator fig4_4 --rate 1,2 --part 1/3", "2 rates for 3 sources"),
    ("simulator fig4_4 --start-at soon", "start 'soon'"),
    ("simulator fig4_4 --time-scale 0", "time scale 0"),
    ("simulator fig4_4 --noise -1", "--noise"),
    ("simulator fig4_4 --split markers", "--split"),
    ("simulator fig4_4 --name A/B", "name 'A/B'"),
    ("simulator fig4_4 --scene A", "scene 'A'"),
    ("replay take.npz --rate 60", "60 Hz exceeds the 50 Hz"),
    ("replay take.npz --rate 10,20 --split 3", "2 rates for 3 sources"),
    ("replay take.npz --speed 0", "speed 0"),
    ("replay take.npz --split 0", "--split"),
    ("replay take.npz --split 2 --part 1/3", "do not agree"),
    ("replay take.npz --stamps none", "--stamps"),
    ("replay take.npz --start-at -1", "start '-1'"),
    (f"replay take.npz --name {'x' * 65}", "1 to 64 characters"),
    ("replay none.c3d", "No such file"),
    ("replay cut.npz", "truncated"),
    ("replay empty.npz", "empty"),
    ("replay text.c3d", "not a C3D file"),
    ("klt nope.mp4", "no such file or folder"),
    ("klt video.avi --calibration wrong.yaml", "wrong.yaml: no camera matrix"),
    ("klt video.avi --calibration missing.yaml", "missing.yaml: No such file or directory"),
    ("klt video.avi --extrinsics inner.toml", "has no [extrinsics]"),
    (
        "klt video.avi --tracker windw=3",
        "unknown tracker parameter 'windw'; one of anchor_reach, birth_sigma",
    ),
    ("klt video.avi --tracker window=1000", "tracker parameter window: "),
    ("klt video.avi --name 'Not A Name'", "name 'Not A Name'"),
    ("external-camera video.avi --marker-size 0.1", "an external camera needs its extrinsics"),
    (
        "external-camera video.avi --marker-size 0.1 --extrinsics identity",
        "markers need the camera's intrinsics",
    ),
    (
        "external-camera video.avi --marker-size 0.1 --dictionary 9x9",
        "no marker dictionary '9x9'; one of 4x4_100",
    ),
]


@pytest.mark.parametrize(("command", "words"), WRONG)
def test_what_a_source_cannot_do_is_one_line(capsys, monkeypatch, files, command, words):
    monkeypatch.chdir(files)
    assert words in refused(capsys, "source", *shlex.split(command))


def test_the_scenes_are_listed(capsys):
    assert run(["source", "simulator", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == scene_names()
    assert "15, 30, 100 Hz" in next(line for line in lines if line.startswith("3d_async"))


def test_progress_is_plain_lines_away_from_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(replay, "_PLAIN_LINE_S", 0.0)
    with replay.shown_progress("take", 20.0) as advance:
        advance(0, 5.0)
        advance(2, 7.5)
    assert capsys.readouterr().err.splitlines() == ["take: 5.0 of 20.0 s", "take, pass 3: 7.5 of 20.0 s"]


def test_progress_is_a_bar_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(replay, "_TERMINAL_LINE_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with replay.shown_progress("take", 20.0) as advance:
        advance(0, 20.0)
    shown = capsys.readouterr().err
    assert "━" * 40 in shown
