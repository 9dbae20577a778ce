"""`comotion watch` and `view` as a user runs them: in a pipe, a script, a terminal of 80x24, into a file."""

import fcntl
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import threading

import pytest

from comotion_schemas import Keys

from ...command_line import refused
from ..waiting import DEADLINE


def test_a_live_scene_into_a_file(start, endpoint, session, listen, live_scene, tmp_path):
    pytest.importorskip("rerun", reason="needs the extra view")
    statuses = listen(session, Keys().streams("status"), "status")
    process = start("view", "--save", tmp_path / "a.rrd", "--connect", endpoint, "--json")
    shown = statuses.until(lambda s: s.role == "viewer" and s.counters.get("updates", 0) > 2)
    assert shown.ages["hypotheses"] < 30
    assert process.interrupt() == 0
    result = json.loads(process.output.partition("ready\n")[2])
    assert result["updates"] > 2
    assert result["dropped"] == 0
    command = [sys.executable, "-m", "rerun", "rrd", "print", tmp_path / "a.rrd"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True)
    assert "/spaces/world/features/camera" in printed.stdout


def test_once_as_json_and_lines_where_the_output_is_no_terminal(start, endpoint, live_scene):
    at = ("--connect", endpoint)
    lines = start("watch", *at, ready=False)
    once = start("watch", "--once", "--json", "--timeout", DEADLINE, *at, ready=False)
    assert once.wait() == 0
    scene = json.loads(once.output)
    (source,) = scene["sources"]
    assert (source["name"], source["state"], source["tracks"]) == ("camera", "ok", 1)
    assert source["rate"] > 0
    assert scene["hypotheses"][0]["id"] == 42
    assert scene["service"]["state"] == "ok"
    lines.wait_line(lambda line: "1 track 1 hypothesis 0 undetermined" in line)
    assert lines.interrupt() == 0
    assert "\x1b" not in lines.output


def test_once_without_a_scene_is_one_clear_line(endpoint, capsys):
    refusal = refused(capsys, "watch", "--once", "--timeout", 0.3, "--connect", endpoint)
    assert refusal == f"error: no message of scene 'default' arrives at {endpoint}"


class Terminal:
    """A process on a pseudo-terminal."""

    def __init__(self, columns, rows, *arguments):
        self._main, worker = pty.openpty()
        self.resize(columns, rows)
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "comotion_deploy", *arguments],
            stdin=worker,
            stdout=worker,
            stderr=worker,
            start_new_session=True,
            env={**os.environ, "TERM": "xterm-256color"},
        )
        os.close(worker)
        self.text = ""

    def resize(self, columns, rows):
        fcntl.ioctl(self._main, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, keys):
        os.write(self._main, keys.encode())

    def until(self, wanted):
        """Read the screen until it says so."""
        alarm = threading.Timer(DEADLINE, self.popen.send_signal, (signal.SIGKILL,))
        alarm.start()
        seen = ""
        while wanted not in seen:
            try:
                seen += os.read(self._main, 65536).decode(errors="replace")
            except OSError:  # the process has gone
                raise AssertionError(f"{wanted!r} was never shown:\n{self.text}{seen}") from None
        alarm.cancel()
        self.text += seen

    def close(self):
        try:
            return self.popen.wait(DEADLINE)
        finally:
            self.popen.kill()
            os.close(self._main)


def test_a_terminal_of_80x24(endpoint, live_scene):
    terminal = Terminal(80, 24, "watch", "--connect", endpoint)
    terminal.until("sorted by size")
    terminal.until("camera")
    terminal.until("42")
    terminal.type("s")
    terminal.until("sorted by name")
    terminal.resize(40, 10)
    terminal.until("sorted by name")
    terminal.type("q")
    terminal.until("\x1b[?1049l")  # back to the normal screen
    assert terminal.close() == 0
