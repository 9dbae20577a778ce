"""Files that cannot be read: one line that names the file, whatever reads it; tests/fuzz has damaged ones."""

import io
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from comotion_schemas.errors import Error
from comotion_sources.calibration.files import read_calibration
from comotion_sources.poses import read_trajectory
from comotion_sources.proprioception.joints import read_csv
from comotion_sources.recordings import read_recording
from comotion_sources.simulator import load_scene

ROS = (Path(__file__).parents[1] / "fuzz" / "corpus" / "yaml" / "valid-ros").read_text()
SCENE = (resources.files("comotion_sources") / "scenes/fig4_1.toml").read_text()
TRACKS = np.full((9, 4, 2), 9.0)
TURN = "quaternion = [0, 0, 0, 1]"


def changed(text: str, old: str, new: str) -> bytes:
    assert old in text
    return text.replace(old, new, 1).encode()


def npz(**changes) -> bytes:
    arrays = {"positions": np.ones((10, 3, 2)), "times": np.arange(10) / 30} | changes
    return packed(**{name: array for name, array in arrays.items() if array is not None})


def packed(**arrays) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def unfinished() -> bytes:
    """An array whose header lacks its last bracket."""
    buffer = io.BytesIO()
    np.save(buffer, TRACKS)
    return buffer.getvalue().replace(b"}", b" ", 1)


WRONG = {
    "camera.yaml": [
        (b"", "not a calibration"),
        (b"hello: [1, 2\n  x: {", "not valid YAML"),
        (bytes(range(256)), "not a text file"),
        (changed(ROS, "plumb_bob", "equidistant"), "distortion model 'equidistant'"),
        (changed(ROS, "438.78,", ""), "8 numbers instead of 9"),
        (changed(ROS, "438.78", "-1"), "not above zero"),
        (changed(ROS, "438.78", ".nan"), "finite"),
        (changed(ROS, "image_width: 640", "image_width: wide"), "width: Input should be a valid integer"),
    ],
    "camera.toml": [
        (b"[intrinsics]\nwidth = 3", "intrinsics.height: Field required"),
        (b"x = 1", "neither"),
        (f"[extrinsics]\ntranslation = [0, 0]\n{TURN}".encode(), "translation"),
        (b"[extrinsics]\ntranslation = [0, 0, 0]\nquaternion = [0, 0, 0, 0]", "quaternion"),
        (f"[extrinsics]\ntranslation = [0, 0, 0]\n{TURN}\nscale = 2".encode(), "extrinsics.scale"),
    ],
    "scene.toml": [
        (b"\xff\xfe\x00", "not a text file"),
        (changed(SCENE, "dim = 2", "dim ="), "not valid TOML"),
        (changed(SCENE, "dim = 2", "dim = 3"), "size needs 3 numbers"),
        (changed(SCENE, "features = 40", "features = -1"), r"bodies\.0\.features"),
        (changed(SCENE, "sigma = 0.01", "sigma = 0.01\nsgima = 1.0"), r"bodies\.0\.sgima"),
        (
            changed(SCENE, "[10.0, 0.85, 0.5, 0.0]", "[0.0, 0.85, 0.5, 0.0]"),
            "times of the states must increase",
        ),
        (changed(SCENE, '"G"', '"R"'), "two bodies have the same name"),
    ],
    "take.npz": [
        (b"positions, times and labels\n", "not an .npz archive"),
        (npz(positions=None), "no array 'positions'"),
        (npz(positions=np.zeros((10, 3))), r"shape \(10, 3\), not \(T, N, 2\)"),
        (npz(positions=np.full((10, 3, 2), "x")), "'positions' has no numbers"),
        (npz(positions=np.full((10, 3, 2), np.nan)), "no observation"),
        (npz(positions=np.zeros((0, 3, 2)), times=np.zeros(0)), "no observation"),
        (npz(positions=np.zeros((1, 3, 2)), times=np.zeros(1)), "fewer than two instants"),
        (npz(times=np.arange(9.0)), "times for 10 frames"),
        (npz(times=np.zeros(10)), "times do not increase"),
        (npz(labels=np.zeros(2, int)), "labels are not 3 integers"),
        (npz(positions=np.ones((10, 3, 3)), units=np.array("furlong")), "unit is 'furlong'"),
        (npz(positions=np.array([[object()]])), "holds Python objects, not numbers"),
    ],
    "tracks.npz": [
        (packed(tracks=TRACKS), "--fps says how many frames per second"),
        (packed(tracks=np.ones((4, 9, 4, 2))), r"shape \(4, 9, 4, 2\), not \(T, N, 2\)"),
        (packed(tracks=TRACKS / 18, fps=30), "within 0 to 1: multiply"),
        (packed(tracks=TRACKS, visibility=np.ones((9, 3))), "'visibility' has the shape"),
        (packed(tracks=TRACKS, fps=30, sigma=np.zeros((9, 4))), "sigma is not above 0"),
        (packed(tracks=TRACKS, fps=-1.0), "not above 0"),
    ],
    "table.csv": [
        (b"frame,track,x\n1,2,3\n", "no columns x and y"),
        (b"track,x,y\n1,2,3\n", "no column 'frame'"),
        (b"frame,x,y\n1,2,3\n", "no column 'track'"),
        (b"frame,track,x,y\n1,2,3,4\n1,2,3,4\n", "a frame has a track twice"),
        (b"frame,track,x,y\n1,2,3\n", "line 2 has 3 cells, the first line 4"),
        (b"frame;Track;X;Y\n1;2;3;left\n", "line 2: 'left' is not a number"),
        (b"frame,track,x,y\n1,-2,3,4\n", "not whole numbers from 0 to"),
        (b"frame\ttrack\tx\ty\n1\t9007199254740994\t3\t4\n", r"to 2\*\*53"),
        (b"frame,track,x,y\n,2,3,4\n", "neither frame nor track"),
    ],
    "take.npy": [(unfinished(), "not an array of numbers, or is damaged")],
    "take.avi": [(b"RIFF", "its ending is not one of .c3d, .npz, .npy, .csv, .mcap")],
    "joints.csv": [
        (b"lift,time\n1,2\n", "first column must be"),
        (b"time\n1\n", "no joint columns"),
        (b"time,lift\n1,2\n2,x\n", "line 3: could not convert"),
        (b"time,lift\n1,2,3\n", "line 2 has 3 cells, the first line 2"),
        (b"time,lift\n1,inf\n", "line 2: a joint position is not finite"),
        (b"time,lift\n1e200,1\n", "line 2: stamp"),
        (b"time,lift,lift\n1,1,1\n", "line 2: a joint is named twice"),
    ],
    "poses.txt": [(b"", "poses"), (b"a b c d e f g h", "poses"), (b"nan 0 0 0 0 0 0 1", "poses")],
}
READERS = {
    "camera": read_calibration,
    "scene": load_scene,
    "take": read_recording,
    "tracks": read_recording,
    "table": lambda path: read_recording(path, 30.0),
    "joints": lambda path: list(read_csv(path)),
    "poses": read_trajectory,
}


@pytest.mark.parametrize(
    ("name", "content", "words"), [(name, *row) for name, rows in WRONG.items() for row in rows]
)
def test_a_wrong_file_is_one_line_that_names_it(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(Error, match=words) as caught:
        READERS[path.stem](path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["camera.yaml", "take.npz", "take.c3d", "joints.csv", "poses.txt"])
def test_a_missing_file_is_one_line_that_names_it(tmp_path, name):
    path = tmp_path / name
    with pytest.raises((Error, OSError), match="No such file"):
        READERS[path.stem](path)
