"""Camera sources as processes: files, RGB-D folders, markers, a network camera that is unplugged."""

import itertools
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_deploy.cli import run
from comotion_schemas import Keys
from comotion_sources.calibration.files import format_calibration, read_calibration
from comotion_sources.calibration.model import Extrinsics, Intrinsics
from comotion_sources.cameras.tum import write_folder
from comotion_sources.cameras.types import Frame
from comotion_sources.markers import find_dictionary

from ..pictures import moving_board, write_video

KEYS = Keys()
SHAPE = (240, 320)
CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
PLACE = Extrinsics(Rotation.from_rotvec([-2.0, 0.1, 0.2]).as_matrix(), np.array([0.5, -1.0, 1.5]))
DEPTH = 1.25
SPEED = 3  # px per frame


@pytest.fixture
def video(tmp_path):
    return write_video(tmp_path / "video.avi", (moving_board(k)[0] for k in range(20)))


@pytest.fixture
def recording(tmp_path):
    """An RGB-D recording with truth; frames 6 to 9 are without depth."""
    frames = []
    for k in range(20):
        image, where = moving_board(k)
        depth = None if 6 <= k < 10 else np.full(SHAPE, DEPTH, np.float32)
        frames.append((Frame(10**18 + k * 33_333_000, image, depth, where), PLACE))
    write_folder(tmp_path / "rgbd", frames, CAMERA, {0: "wall", 1: "board"})
    return tmp_path / "rgbd"


def test_a_video_becomes_tracks_in_its_own_pixel_space_and_a_preview_on_request(
    start, endpoint, session, listen, video
):
    batches = listen(session, KEYS.stream("obs", "door"), "obs")
    previews = listen(session, KEYS.stream("preview", "door"), "preview")
    source = start("source", "klt", video, "--name", "door", "--connect", endpoint)
    first = batches.next()
    last = batches.until(lambda batch: batch.ended is not None and not len(batch.ids))
    assert source.wait() == 0
    assert (first.space, first.unit, first.dim, first.seq) == ("door/pixels", "px", 2, 0)
    assert len(first.ids) > 50
    assert (first.sigma > 0).all()
    assert last.seq > 5
    assert source.lines[-1].startswith(f"INFO: {video}: ended; ")
    preview = previews.next()
    image = cv2.imdecode(np.frombuffer(preview.image, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (*SHAPE, 3)
    assert len(preview.ids) == len(preview.pixels) > 50


def test_depth_lifts_the_tracks_into_the_world_with_their_truth(start, endpoint, session, listen, recording):
    batches = listen(session, KEYS.stream("obs", "a"), "obs")
    truths = listen(session, KEYS.stream("truth", "a"), "truth")
    source = start(
        *("source", "klt", recording, "--name", "a", "--stamps", "original", "--no-realtime"),
        *("--connect", endpoint),
    )
    assert source.wait() == 0
    truth = truths.next()
    assert truth.names == {"0": "wall", "1": "board"}
    true = dict(zip(truth.ids.tolist(), truth.objects.tolist(), strict=True))
    got = [batches.next() for _ in range(20)]
    assert [batch.seq for batch in got] == list(range(20))
    assert {(batch.space, batch.unit, batch.dim) for batch in got} == {("world", "m", 3)}
    assert got[3].stamp_ns == 10**18 + 3 * 33_333_000
    assert [len(batch.ids) > 0 for batch in got] == [not 6 <= k < 10 for k in range(20)]
    # Positions are where the features are in the world; those of the board move with it.
    first, last = (
        dict(zip(b.ids.tolist(), b.positions.astype(float), strict=True)) for b in (got[0], got[-1])
    )
    depths = PLACE.inverse().apply(np.array([*last.values()]))[:, 2]
    np.testing.assert_allclose(depths, DEPTH, atol=1e-3)
    for moving, step in ((1, SPEED * 19 * DEPTH / CAMERA.fx), (0, 0.0)):
        ways = [last[i] - first[i] for i in first.keys() & last.keys() if true[i] == moving]
        way = PLACE.rotation.T @ np.median(ways, axis=0)
        np.testing.assert_allclose(way, [step, 0, 0], atol=3e-3)
    assert "depth_missing 4" in source.output
    assert "no depth" in source.output
    assert "depth is back" in source.output


def marker_images(folder: Path) -> list[np.ndarray]:
    """A marker that moves sideways, facing the camera; its middle in px."""
    folder.mkdir()
    marker = cv2.aruco.generateImageMarker(find_dictionary("apriltag_36h11"), 11, 60)
    middles = []
    for k in range(8):
        image = cv2.cvtColor(np.full(SHAPE, 200, np.uint8), cv2.COLOR_GRAY2BGR)
        x, y = 60 + 10 * k, 90
        image[y : y + 60, x : x + 60] = marker[:, :, None]
        middles.append(np.array([x + 29.5, y + 29.5]))
        assert cv2.imwrite(str(folder / f"{k}.png"), cv2.GaussianBlur(image, (3, 3), 0.5))
    return middles


def test_an_external_camera_publishes_markers_with_their_orientation(
    start, endpoint, session, listen, tmp_path
):
    middles = marker_images(tmp_path / "images")
    calibration = tmp_path / "b.toml"
    calibration.write_text(format_calibration(CAMERA, PLACE))
    batches = listen(session, KEYS.stream("obs", "b-markers"), "obs")
    pixels = listen(session, KEYS.stream("obs", "b"), "obs")
    statuses = listen(session, KEYS.stream("status", "b-markers"), "status")
    source = start(
        *("source", "external-camera", tmp_path / "images", "--name", "b", "--no-realtime"),
        *("--calibration", calibration, "--marker-size", "0.12", "--dictionary", "apriltag_36h11"),
        *("--clock-offset", "-0.25", "--connect", endpoint),
    )
    assert source.wait() == 0
    got = [batches.next() for _ in range(8)]
    assert {(batch.space, batch.dim) for batch in got} == {("world", 3)}
    facing = PLACE.rotation @ np.diag([1.0, -1.0, -1.0])
    for batch, middle in zip(got, middles, strict=True):
        assert batch.ids.tolist() == [11]
        true = PLACE.apply(CAMERA.lift(middle, [0.12 * CAMERA.fx / 60]))[0]
        np.testing.assert_allclose(batch.positions[0], true, atol=0.01)
        turned = Rotation.from_matrix(facing).inv() * Rotation.from_quat(batch.quaternions[0])
        assert turned.magnitude() < np.deg2rad(8)
    assert pixels.next().space == "b/pixels"
    assert statuses.until(lambda status: status.feature_names).feature_names == {"11": "marker 11"}


class Stream(BaseHTTPRequestHandler):
    """MJPEG for as long as the camera is plugged in."""

    def do_GET(self):
        unplugged = self.server.unplugged
        self.send_response(503 if unplugged.is_set() else 200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        for k in itertools.count():
            if unplugged.wait(0.03):
                return
            encoded = cv2.imencode(".jpg", moving_board(k % 20)[0])[1].tobytes()
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(encoded)}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + encoded + b"\r\n")
            except OSError:
                return

    def log_message(self, *arguments):
        pass


@pytest.fixture
def network_camera():
    """A camera on a port of its own; can be unplugged and plugged in again."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Stream) as camera:
        camera.unplugged = threading.Event()
        camera.url = f"http://127.0.0.1:{camera.server_port}/stream.mjpg"
        thread = threading.Thread(target=camera.serve_forever, daemon=True)
        thread.start()
        yield camera
        camera.unplugged.set()
        camera.shutdown()
    thread.join()


def test_an_unplugged_camera_is_told_and_comes_back_and_ctrl_c_ends_one_that_is_away(
    start, endpoint, session, listen, network_camera
):
    statuses = listen(session, KEYS.stream("status", "klt"), "status")
    batches = listen(session, KEYS.stream("obs", "klt"), "obs")
    source = start("source", "klt", network_camera.url, "--connect", endpoint)
    earlier = batches.until(lambda batch: len(batch.ids) > 50)

    network_camera.unplugged.set()
    gone = batches.until(lambda batch: batch.ended is not None and not len(batch.ids))
    assert set(earlier.ids.tolist()) & set(gone.ended.tolist())
    lost = statuses.until(lambda status: status.state == "degraded")
    assert "lost" in lost.message
    assert network_camera.url in lost.message

    network_camera.unplugged.clear()
    after = batches.until(lambda batch: len(batch.ids) > 50)
    assert after.session == earlier.session
    assert not set(after.ids.tolist()) & set(gone.ended.tolist())
    assert statuses.until(lambda status: status.state == "ok").counters["reconnects"] == 1

    printed = len(source.lines)
    network_camera.unplugged.set()
    source.wait_line(lambda line: "trying again" in line, start=printed)
    assert source.interrupt() == 0


def test_an_unplugged_camera_may_end_the_process(start, endpoint, network_camera):
    source = start("source", "klt", network_camera.url, "--no-reconnect", "--connect", endpoint)
    network_camera.unplugged.set()
    assert source.wait() == 2
    assert source.lines[-1].startswith("error: http://127.0.0.1")


def test_calibrate_writes_what_an_external_camera_reads(monkeypatch, capsys, tmp_path):
    board = cv2.aruco.CharucoBoard((5, 4), 0.04, 0.03, find_dictionary("4x4_50"))
    sheet = np.pad(board.generateImage((250, 200), marginSize=0), 10, constant_values=255)
    for name, x in (("a", 20), ("b", 50)):
        image = np.full(SHAPE, 200, np.uint8)
        image[10:230, x : x + 250] = sheet[:, :250]
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    (tmp_path / "inner.toml").write_text(format_calibration(CAMERA, None))
    monkeypatch.chdir(tmp_path)
    arguments = "--calibration-a inner.toml --calibration-b inner.toml -o b.toml"
    assert run(["calibrate", "a.png", "b.png", "--target", "charuco:5x4:0.04:0.03", *arguments.split()]) == 0
    assert "1 views, reprojection error" in capsys.readouterr().out
    written = read_calibration(tmp_path / "b.toml")
    assert (written.intrinsics.width, written.extrinsics.frame) == (SHAPE[1], "world")
    # The board is seen 30 px further right: the camera stands that much further left.
    np.testing.assert_allclose(written.extrinsics.translation, [-30 * 0.04 / 50, 0, 0], atol=5e-3)
