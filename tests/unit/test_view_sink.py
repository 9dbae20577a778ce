"""What Rerun is given: read back from the file, and the errors a user sees before anything opens."""

import socket
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_schemas import UNDETERMINED, Event, Pose, Preview, TruthBatch, Twist, encode

from ..builders import SESSION, S, batch, hypothesis, update
from ..command_line import refused


@pytest.fixture
def sink():
    """The module, where the extra `view` is there."""
    pytest.importorskip("rerun", reason="needs the extra view").set_strict_mode(True)
    return pytest.importorskip("comotion_clients.viewing.sink")


def test_without_the_extra_the_command_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert refused(capsys, "view", "--web") == "error: rerun is not installed: pip install 'comotion[view]'"


def test_without_a_display_the_command_says_what_to_do(sink, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert "use --web (browser) or --save FILE.rrd" in refused(capsys, "view")


def test_an_endpoint_that_is_wrong_leaves_no_file(sink, tmp_path, capsys):
    refused(capsys, "view", "--save", tmp_path / "a.rrd", "--tls", tmp_path / "none")
    assert not list(tmp_path.iterdir())


def test_page_and_data_are_for_this_machine_alone(sink):
    page, data = sink.free_port(), sink.free_port()
    with sink.RerunSink(web_port=page, data_port=data) as shown:
        assert str(page) in shown.url
        # Of every listening socket: local address and state, see proc_net_tcp.
        lines = [Path("/proc/net", name).read_text().splitlines()[1:] for name in ("tcp", "tcp6")]
        sockets = [line.split() for line in lines[0] + lines[1]]
        addresses = {s[1].split(":")[0] for s in sockets if int(s[1].split(":")[1], 16) in {page, data}}
    assert addresses == {"0100007F"}


@pytest.mark.parametrize("taken", ["web_port", "data_port"])
def test_a_port_in_use_is_an_error_that_names_it(sink, taken):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        ports = {"web_port": sink.free_port(), "data_port": sink.free_port(), taken: port}
        with pytest.raises(OSError, match=str(port)), sink.RerunSink(**ports):
            pass


def test_every_shape_arrives_in_the_file(sink, tmp_path):
    from comotion_clients.viewing.picture import ScenePicture

    picture = ScenePicture("lab")
    with sink.RerunSink(file=tmp_path / "a.rrd") as shown:
        for k in range(1, 6):
            moments = feed(picture, k)
            shown.arrange(picture.layout)
            shown.show(moments)
    told = printed(tmp_path / "a.rrd")
    expected = [
        "/cameras/a/image", "/cameras/a/features", "/lags/a", "/legend/dots", "/log", "/rates/a",
        "/scores/plane/nmi", "/sizes/1", "/spaces/plane/features/a", "/spaces/plane/frames", "/summary",
        "/spaces/plane/hypotheses", "/spaces/plane/trails", "/spaces/plane/twist/linear",
    ]  # fmt: skip
    assert [path for path in expected if path not in told] == []


def test_a_recording_is_shown(sink, tmp_path, capsys):
    pytest.importorskip("mcap")
    from comotion_clients.recording.file import RecordingFile

    with RecordingFile(tmp_path / "a.mcap", scene="lab") as file:
        for k in range(1, 6):
            for key, message in (("obs/a", seen(k)), ("hypotheses", found(k))):
                file.add(f"comotion/@v1/lab/{key}", k * S, encode(message), message)
    assert run(["view", str(tmp_path / "a.mcap"), "--save", str(tmp_path / "a.rrd")]) == 0
    assert "5 updates" in capsys.readouterr().err
    assert "/spaces/plane/features/a" in printed(tmp_path / "a.rrd")


def printed(path):
    import rerun_cli

    command = [Path(rerun_cli.__file__).with_name("rerun"), "rrd", "print", "-v", path]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def feed(picture, k):
    image = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    truth = TruthBatch(source="a", session=SESSION, ids=[10, 11], objects=[0, 1], names={})
    jpeg = {"encoding": "jpeg", "image": image, "ids": [10], "pixels": [[1, 2]]}
    preview = Preview(source="a", session=SESSION, stamp_ns=k * S, **jpeg)
    messages = (seen(k), truth, preview, found(k))
    moments = [moment for message in messages for moment in picture.on_message(message, float(k), k * S)]
    return moments + picture.tick(k + 0.5)


def seen(k):
    return batch("a", k, k * S, np.full((2, 2), k), space="plane", ids=[10, 11])


def found(k):
    pose, twist = Pose(translation=[0.0, 0.0], rotation=0.1), Twist(linear=[1.0, 0.0], angular=1.0)
    return update(
        [1, UNDETERMINED],
        seq=k,
        stamp_ns=k * S,
        track_id=[10, 11],
        track_position=np.array([[k, k, np.nan]] * 2, np.float32),
        hypotheses=[hypothesis(1, space="plane", centroid=[float(k), float(k)], pose=pose, twist=twist)],
        events=[Event(stamp_ns=k * S, kind="born", hypothesis=1, others=[])],
    )
