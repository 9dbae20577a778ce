"""``comotion up``: real systems of processes, killed in every way, leaving nothing behind."""

import json
import os
import re
import select
import signal
import threading
from dataclasses import replace

from comotion_deploy.launcher import Launcher
from comotion_deploy.processes import ProcessSpec
from comotion_schemas import UNDETERMINED, Keys
from comotion_tools.soak import load

from ..builders import by_feature as labels
from .conftest import TWO_BODIES
from .waiting import DEADLINE, until

KEYS = Keys()
STATE = "system.state"


def system_file(folder, endpoint):
    """The file of router, service and two trackers in spaces of their own."""

    def tracker_command(name):
        return json.dumps(load.command(endpoint, "default", name, replace(TWO_BODIES, space=name)))

    file = folder / "system.toml"
    file.write_text(
        f"""
connect = ["{endpoint}"]
[router]
listen = ["{endpoint}"]
[serve]
state = "{folder / STATE}"
state-interval = 0.2
[fusion]
method = "thesis"
# On a loaded machine a restart of the service takes longer than the default.
window = 60
[process.router]
run = "router"
[process.serve]
run = "serve"
[process.left]
command = {tracker_command("left")}
[process.right]
command = {tracker_command("right")}
"""
    )
    return file


def pid_of(launcher, name, start=0):
    """Process id of a child, from the launcher's own lines."""
    pattern = re.compile(rf"\| started {name}, pid (\d+)")
    match = pattern.search(launcher.wait_line(lambda line: pattern.search(line) is not None, start=start))
    assert match is not None
    return int(match[1])


def await_end(pid):
    """Wait until a process that is no child of ours has ended."""
    try:
        handle = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        assert select.select([handle], [], [], DEADLINE)[0], f"process {pid} lives on"
    finally:
        os.close(handle)


def is_sorted_out(update):
    """Two sources with two bodies each make four hypotheses of six."""
    by_track = [label for _, label in sorted(labels(update).items())]
    bodies = [set(by_track[k : k + 6]) for k in range(0, len(by_track), 6)]
    apart = all(len(b) == 1 for b in bodies) and len(set().union(*bodies)) == 4
    return len(by_track) == 24 and UNDETERMINED not in by_track and apart


def settled(updates):
    """The last of ten updates that sort all tracks out alike."""
    update, same = updates.until(is_sorted_out), 0
    while same < 10:
        newest = updates.until(is_sorted_out)
        same = same + 1 if labels(newest) == labels(update) else 0
        update = newest
    return update


def until_kept(state):
    """Wait until a state that is taken from now on has been written."""
    until(state.exists)
    for _ in range(2):  # the first may have been taken before
        written_ns = state.stat().st_mtime_ns
        until(lambda: state.stat().st_mtime_ns > written_ns)  # noqa: B023


def test_what_dies_is_started_again_and_nothing_is_left_behind(
    start, free_port_endpoint, connect, listen, tmp_path
):
    launcher = start("up", system_file(tmp_path, free_port_endpoint), ready=False)
    launcher.wait_line(lambda line: "all processes are ready" in line)
    updates = listen(connect(free_port_endpoint), KEYS.hypotheses, "hypotheses")

    def kill(name):
        seen = len(launcher.lines)
        os.kill(pid_of(launcher, name), signal.SIGKILL)
        pid_of(launcher, name, seen)

    before = settled(updates)
    kill("left")
    updates.until(lambda u: u.sources != before.sources)
    restarted = settled(updates)
    expected = labels(restarted)
    assert restarted.session == before.session
    of_right = {track: label for track, label in expected.items() if track[0] == "right"}
    assert of_right.items() <= labels(before).items()

    until_kept(tmp_path / STATE)
    kill("serve")
    after_service = updates.until(lambda u: u.session != before.session and is_sorted_out(u))
    assert labels(after_service) == expected

    kill("router")
    updates.drain()
    after_router = settled(updates)
    assert (after_router.session, labels(after_router)) == (after_service.session, expected)

    children = [int(pid) for pid in re.findall(r"started \w+, pid (\d+)", launcher.output)]
    assert len(children) == 7
    assert launcher.interrupt() == 0
    for pid in children:
        await_end(pid)


def test_a_killed_launcher_takes_everything_with_it(start, tmp_path):
    names = ("router", "left", "right")
    run = "\n".join(f"[process.{name}]\ncommand = 'sleep 1000'" for name in names[1:])
    (tmp_path / "up.toml").write_text(f"[process.router]\nrun = 'router --listen tcp/127.0.0.1:0'\n{run}")
    launcher = start("up", tmp_path / "up.toml", ready=False)
    launcher.wait_line(lambda line: "all processes are ready" in line)
    children = [pid_of(launcher, name) for name in names]
    launcher.kill()
    for pid in children:
        await_end(pid)


def test_a_process_that_cannot_start_ends_the_launcher_with_one_line(start, tmp_path):
    (tmp_path / "up.toml").write_text("[process.router]\nrun = 'router --insecure --listen tcp/nowhere'")
    launcher = start("up", tmp_path / "up.toml", ready=False)
    assert launcher.wait() == 2
    assert [line for line in launcher.lines if line.startswith("error: ")] == [launcher.lines[-1]]
    assert "router cannot start: 'tcp/nowhere' is not an address to listen at" in launcher.lines[-1]
    assert "Traceback" not in launcher.output


def test_processes_that_have_done_their_work_end_the_launcher(start, tmp_path):
    (tmp_path / "up.toml").write_text("[process.a]\ncommand = 'echo hello'\n[process.b]\ncommand = 'true'")
    launcher = start("up", tmp_path / "up.toml", ready=False)
    assert launcher.wait() == 0
    assert "       a | hello" in launcher.lines
    assert "all processes have ended" in launcher.output


def test_a_process_that_ignores_the_stop_is_killed(tmp_path):
    stop, lines = threading.Event(), []

    def write(name, text):
        lines.append(text)
        if text == "listening":
            stop.set()

    deaf = ("sh", "-c", "trap '' TERM; echo listening; while :; do sleep 60; done")
    spec = ProcessSpec(name="deaf", command=deaf, says_ready=False, stop_s=0.3)
    Launcher([spec], tmp_path, write, stop).run()
    assert "deaf did not stop in time and was killed" in lines
    await_end(int(next(line for line in lines if line.startswith("started deaf, pid ")).split()[-1]))
