"""``comotion source simulator`` and ``replay``: a known error is one line and exit 2."""

import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_sources import playback
from comotion_sources.simulator import scene_names


@pytest.fixture
def take(tmp_path):
    path = tmp_path / "take.npz"
    np.savez(path, positions=np.ones((50, 4, 3)), times=np.arange(50) / 50)
    return path


def fails(capsys, *arguments):
    """The one line on standard error of a command that exits with 2."""
    assert run(["source", *map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    return captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "which scene"),
        (("fig9",), "no scene 'fig9'"),
        (("fig4_4", "--part", "4/3"), "part '4/3'"),
        (("fig4_4", "--rate", "0"), "rate '0'"),
        (("fig4_4", "--rate", "1,2", "--part", "1/3"), "2 rates for 3 sources"),
        (("fig4_4", "--start-at", "soon"), "start 'soon'"),
        (("fig4_4", "--time-scale", "0"), "time scale 0"),
        (("fig4_4", "--noise", "-1"), "--noise"),
        (("fig4_4", "--split", "markers"), "--split"),
        (("fig4_4", "--name", "A/B"), "name 'A/B'"),
        (("fig4_4", "--scene", "A"), "scene 'A'"),
    ],
    ids=str,
)
def test_a_wrong_simulator_option_is_one_line(capsys, arguments, words):
    assert words in fails(capsys, "simulator", *arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--rate", "60"), "60 Hz exceeds the 50 Hz"),
        (("--rate", "10,20", "--split", "3"), "2 rates for 3 sources"),
        (("--speed", "0"), "speed 0"),
        (("--split", "0"), "--split"),
        (("--split", "2", "--part", "1/3"), "do not agree"),
        (("--stamps", "none"), "--stamps"),
        (("--start-at", "-1"), "start '-1'"),
        (("--name", "x" * 65), "1 to 64 characters"),
    ],
    ids=str,
)
def test_a_wrong_replay_option_is_one_line(capsys, take, arguments, words):
    assert words in fails(capsys, "replay", take, *arguments)


def test_a_wrong_recording_is_one_line(capsys, take, tmp_path):
    assert "No such file" in fails(capsys, "replay", tmp_path / "none.c3d")
    take.write_bytes(take.read_bytes()[:500])
    assert "truncated" in fails(capsys, "replay", take)
    take.write_bytes(b"")
    assert "empty" in fails(capsys, "replay", take)
    text = tmp_path / "take.c3d"
    text.write_text("x" * 2000)
    assert "not a C3D file" in fails(capsys, "replay", text)


def test_the_scenes_are_listed(capsys):
    assert run(["source", "simulator", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == scene_names()
    assert "15, 30, 100 Hz" in next(line for line in lines if line.startswith("3d_async"))


def test_progress_is_plain_lines_away_from_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(playback, "_PLAIN_LINE_S", 0.0)
    with playback.shown_progress("take", 20.0) as advance:
        advance(0, 5.0)
        advance(2, 7.5)
    assert capsys.readouterr().err.splitlines() == ["take: 5.0 of 20.0 s", "take, pass 3: 7.5 of 20.0 s"]


def test_progress_is_a_bar_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(playback, "_TERMINAL_LINE_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with playback.shown_progress("take", 20.0) as advance:
        advance(0, 20.0)
    shown = capsys.readouterr().err
    assert "━" * 40 in shown
