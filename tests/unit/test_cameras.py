"""Adapters: whatever the user names yields frames with the right stamps, or one clear line."""

import threading
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from comotion_schemas.errors import InputError
from comotion_sources.calibration.model import Extrinsics, Intrinsics
from comotion_sources.cameras.live import LiveCamera, captured
from comotion_sources.cameras.opening import open_frames
from comotion_sources.cameras.tum import write_folder
from comotion_sources.cameras.types import Frame
from comotion_sources.klt.options import CameraOptions, Pacer

from ..builders import MS
from ..pictures import write_video

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def image(value, shape=(48, 64)):
    return np.full((*shape, 3), value, np.uint8)


def write_images(folder, names):
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), image(10 * number))


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("99", "camera 99"),
        ("/dev/video98", "camera 98"),
        ("rtsp://user:secret@127.0.0.1:9/x", "rtsp://127.0.0.1:9/x: nothing answers"),
    ],
)
def test_what_cannot_be_opened_is_told_in_one_line(what, reason):
    with pytest.raises(InputError, match=reason) as caught:
        open_frames(what)
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("names", "rate", "stamps"),
    [
        (["img_1.png", "img_2.png", "img_10.png"], 10, [0, 100 * MS, 200 * MS]),
        (
            ["1305031102.175304.png", "1305031102.211214.png"],
            None,
            [1305031102175304000, 1305031102211214000],
        ),
    ],
)
def test_a_folder_of_images_in_natural_order_with_names_that_may_be_times(tmp_path, names, rate, stamps):
    write_images(tmp_path, names)
    camera = open_frames(str(tmp_path), rate=rate)
    for _ in range(2):  # again from the start
        assert [frame.stamp_ns for frame in camera] == stamps
        assert [int(frame.image[0, 0, 0]) for frame in camera] == [10 * k for k in range(len(names))]


def test_an_image_that_cannot_be_read_is_counted_and_told(tmp_path, caplog):
    write_images(tmp_path, ["a.png", "b.png", "c.png"])
    (tmp_path / "b.png").write_bytes(b"\x89PNG broken")
    camera = open_frames(str(tmp_path), rate=10)
    assert [frame.stamp_ns for frame in camera] == [0, 200_000_000]
    assert camera.counters["unreadable"] == 1
    assert "b.png: not a readable image; skipped" in caplog.text


def test_a_video_has_its_own_time(tmp_path):
    camera = open_frames(str(write_video(tmp_path / "video.avi", (image(20 * k) for k in range(10)), 25.0)))
    assert (camera.rate, camera.live) == (25.0, False)
    assert [frame.stamp_ns for frame in camera] == [k * 40_000_000 for k in range(10)]
    assert len(list(camera)) == 10


def write_tum(folder, stamps, depth=True):
    frames, pose = [], Extrinsics(translation=np.array([1.0, 2.0, 3.0]))
    for k, stamp in enumerate(stamps):
        z = np.full((48, 64), 1.2346 + k, np.float32)
        z[0], z[1], z[2] = 0, np.nan, 20.0
        objects = np.zeros((48, 64), np.int32)
        objects[:, :5] = -1
        frames.append((Frame(stamp, image(k), z if depth else None, objects), pose))
    write_folder(folder, frames, CAMERA, {0: "table", 1: "a red box"})


def test_a_tum_folder_round_trips(tmp_path):
    stamps = [1_700_000_000_123_456_000, 1_700_000_000_156_790_000]
    write_tum(tmp_path / "t", stamps)
    camera = open_frames(str(tmp_path / "t"))
    frames = list(camera)
    assert [frame.stamp_ns for frame in frames] == stamps
    assert camera.has_depth
    np.testing.assert_array_equal(camera.intrinsics.matrix, CAMERA.matrix)
    np.testing.assert_allclose(camera.extrinsics.translation, [1, 2, 3])
    assert camera.objects == {0: "table", 1: "a red box"}
    np.testing.assert_allclose(frames[1].depth[3:], 2.2346, atol=1e-4)
    # Missing, and beyond what 16 bits hold.
    assert not frames[1].depth[:3].any()
    assert set(np.unique(frames[1].objects[:, :5])) == {-1}
    assert set(np.unique(frames[1].objects[:, 5:])) == {0}
    with pytest.raises(InputError, match="exists already"):
        write_folder(tmp_path / "t", [])


def test_the_pose_of_a_camera_that_moves_is_not_taken_for_a_fixed_one(tmp_path):
    write_tum(tmp_path / "t", [1_000_000_000, 2_000_000_000])
    path = tmp_path / "t" / "groundtruth.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], lines[2].replace(" 1.0", " 1.1")]))
    assert open_frames(str(tmp_path / "t")).extrinsics is None


def test_depth_is_the_nearest_within_20_ms_or_missing(tmp_path):
    folder = tmp_path / "t"
    write_tum(folder, [1_000_000_000, 2_000_000_000, 3_000_000_000])
    text = (folder / "depth.txt").read_text()
    text = text.replace("\n1.000000 ", "\n1.015000 ").replace("\n2.000000 ", "\n2.025000 ")
    (folder / "depth.txt").write_text(text)
    camera: Any = open_frames(str(folder))
    assert [frame.depth is not None for frame in camera] == [True, False, True]
    assert camera.counters["depth_missing"] == 1


DAMAGED = {
    "empty": b"",
    "no image": b"\x89PNG broken",
    "of another size": cv2.imencode(".png", np.ones((24, 32), np.uint16))[1].tobytes(),
    "of 8 bits": cv2.imencode(".png", np.ones((48, 64), np.uint8))[1].tobytes(),
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_depth_image_is_missing_depth(tmp_path, content):
    write_tum(tmp_path / "t", [1_000_000_000, 2_000_000_000])
    (tmp_path / "t" / "depth" / "1.000000.png").write_bytes(content)
    camera: Any = open_frames(str(tmp_path / "t"))
    assert [frame.depth is not None for frame in camera] == [False, True]
    assert camera.counters["depth_missing"] == 1


class Scripted:
    """A device that plays frames when told, then is unplugged."""

    def __init__(self):
        self.frames: list[Frame | Exception | None] = []
        self.go = threading.Semaphore(0)
        self.requests = threading.Semaphore(0)
        self.closed = threading.Event()

    def play(self, *frames):
        self.frames.extend(frames)
        for _ in frames:
            self.go.release()

    def read(self):
        self.requests.release()
        self.go.acquire()
        frame = self.frames.pop(0)
        if isinstance(frame, Exception):
            raise frame
        return frame

    def played(self):
        try:
            while (frame := self.read()) is not None:
                yield frame
        finally:
            self.closed.set()


def test_a_live_camera_yields_the_newest_frame_and_counts_the_others():
    device = Scripted()
    camera = LiveCamera("camera 0", device.played())
    frames = iter(camera)
    device.play(*(Frame(k, image(k)) for k in range(4)))
    # It is waiting for the fifth: four have come.
    assert all(device.requests.acquire(timeout=10) for _ in range(5))
    assert next(frames).stamp_ns == 3
    assert camera.counters == {"skipped": 3}
    for end, reason in (
        (None, "the camera stopped delivering"),
        (RuntimeError("no frame for 5 s:\n  USB was unplugged"), "no frame for 5 s: USB was unplugged"),
    ):
        device = Scripted()
        camera = LiveCamera("camera 0", device.played())
        device.play(end)
        with pytest.raises(InputError, match=f"camera 0: {reason}"):
            next(iter(camera))
        assert device.closed.wait(10)
        camera.close()
        camera.close()


def test_stamps_are_the_devices_where_it_has_one(monkeypatch):
    clock = SimpleNamespace(monotonic_ns=lambda: 50_000_000_000)
    monkeypatch.setattr("comotion_sources.cameras.live.time", clock)
    cases = {("V4L2", 49_970.0): -30 * MS, ("V4L2", 12.0): 0, ("V4L2", 6e4): 0, ("FFMPEG", 49_970.0): 0}
    for (backend, position), offset in cases.items():
        capture = SimpleNamespace(
            getBackendName=lambda backend=backend: backend,
            get={cv2.CAP_PROP_POS_MSEC: position}.get,
            grab=lambda: True,
            retrieve=lambda: (True, image(1)),
            release=list,
        )
        frame = next(captured(capture, clock=lambda: 1_700_000_000_000_000_000))
        assert frame.stamp_ns == 1_700_000_000_000_000_000 + offset


class Clock:
    """A clock that moves when somebody waits."""

    def __init__(self):
        self.now = 1_000_000_000_000
        self.waited: list[float] = []

    def __call__(self):
        return self.now

    def wait(self, seconds):
        self.waited.append(round(seconds, 6))
        self.now += round(seconds * 1e9)


def pacer(live=False, **pacing):
    clock = Clock()
    return Pacer(
        CameraOptions(**pacing), live, clock.wait, wall=lambda: clock.now + 7, monotonic=clock
    ), clock


def test_frames_that_come_late_or_twice_are_counted():
    for live in (True, False):
        paced, _ = pacer(live=live, realtime=False, stamps="original")
        stamps = (10, 20, 20, 15, 30, 30, 30)
        assert [paced.admit(stamp) for stamp in stamps] == [10, 20, None, None, 30, None, None]
        assert paced.counters["late"] == 1
        assert paced.counters["duplicates"] == 3


def test_a_device_whose_clock_is_set_back_goes_on():
    paced, _ = pacer(live=True, rate=10.0)
    stamps = [10_000 * MS, 10_100 * MS, 3_000 * MS, 3_100 * MS]
    assert [paced.admit(stamp) for stamp in stamps] == stamps
    assert paced.counters["clock_steps"] == 1


def test_a_recording_that_is_held_up_leaves_frames_out_to_catch_up():
    paced, clock = pacer()
    start = clock.now + 7
    assert paced.admit(0) == start
    clock.now += 1_000 * MS
    assert paced.admit(40 * MS) is None
    assert paced.admit(900 * MS) == start + 900 * MS
    assert (paced.counters["overruns"], paced.counters["slips"]) == (1, 0)


def test_a_second_pass_follows_the_first():
    for stamps, base in (("now", 1_000_000_000_007), ("original", 5 * MS)):
        paced, clock = pacer(stamps=stamps)
        first = [paced.admit(stamp) for stamp in (5 * MS, 45 * MS)]
        paced.rewind(40 * MS)
        second = [paced.admit(stamp) for stamp in (5 * MS, 45 * MS)]
        assert first + second == [base, base + 40 * MS, base + 80 * MS, base + 120 * MS]
        assert clock.waited == [0.04, 0.04, 0.04]


def test_thinning_keeps_the_rate_over_jitter():
    rng = np.random.default_rng(0)
    stamps = (np.arange(300) * 33_333_333 + rng.integers(0, 2 * MS, 300)).tolist()
    for rate in (15.0, 10.0, 12.5, 60.0):
        paced, _ = pacer(live=True, rate=rate)
        kept = [paced.admit(stamp) for stamp in stamps]
        count = sum(stamp is not None for stamp in kept)
        assert abs(count - min(rate, 30) * 10) <= 2, rate
        assert count + paced.counters["thinned"] == 300
