"""Commands that cannot be right: one line, status 2, and nothing begun."""

import shlex

import numpy as np
import pytest

from comotion_sources.calibration.files import format_calibration
from comotion_sources.calibration.model import Extrinsics, Intrinsics

from ..command_line import refused
from ..pictures import write_video


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the files that the commands name."""
    folder = tmp_path_factory.mktemp("files")
    np.savez(folder / "take.npz", positions=np.ones((50, 4, 3)), times=np.arange(50) / 50)
    (folder / "cut.npz").write_bytes((folder / "take.npz").read_bytes()[:500])
    (folder / "a.rrd").touch()
    (folder / "text.mp4").write_text("no video")
    for number, content in enumerate((b"", b"nonsense" * 100, b"\x89MCAP0\r\n")):
        (folder / f"{number}.mcap").write_bytes(content)
    write_video(folder / "video.avi", [np.zeros((240, 320, 3), np.uint8)])
    (folder / "wrong.yaml").write_text("image_width: 320\n")
    inner = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    (folder / "inner.toml").write_text(format_calibration(inner, None))
    (folder / "outer.toml").write_text(format_calibration(None, Extrinsics()))
    return folder


OF_ROBOTS = [
    ("source workcell nope", "no workcell scene 'nope'; one of arm,"),
    ("source workcell", "which scene?"),
    ("source klt workcell:moon/a", "moon"),
    ("source klt workcell:truck", "SCENE/CAMERA"),
    ("source klt workcell:truck/a?scene=arm", "scene is not an option"),
    ("source workcell truck --write-tum x --camera z", "truck has no camera 'z'"),
    ("source proprioception none.urdf --joints ur", "none.urdf: No such file"),
    ("source proprioception workcell:arm --csv none.csv", "none.csv: no such file"),
    ("source proprioception workcell:arm --csv a --joints b", "name one input"),
    ("source proprioception workcell:arm --link leg", "no body 'leg'"),
    ("source proprioception workcell:arm --base 1,2", "--base 1,2: expected X,Y,Z"),
]
OF_VIEWERS = [
    ("view --save a.rrd", "a.rrd exists, and is not replaced"),
    ("view --save a.png", "ends in .rrd"),
    ("view a.mcap --save b.rrd", "a.mcap"),
    ("view a.rrd --web", "rerun a.rrd"),
    ("view --save b.rrd --memory much", "2GB"),
]


OF_RECORDINGS = "record --repair", "record --export", "evaluate", "source replay"
WRONG = [
    ("confg", "No such command 'confg'"),
    ("config --sett a=1", "No such option: --sett"),
    ("config --set window", "expected NAME=VALUE"),
    ("config --set windw=3", "unknown fusion parameter 'windw'; did you mean window?"),
    ("config --set linking.cameras.a/pixels={}", "fusion parameter linking.cameras.a/pixels.fx"),
    ("config --config none.toml", "none.toml: No such file"),
    ("serve --clock sundial", "--clock"),
    ("serve --scene 'Two Words'", "scene 'Two Words' is not"),
    ("serve --connect nonsense", "cannot open a session at nonsense"),
    ("serve --camera door", "expected NAME=FILE"),
    ("serve --camera door=inner.toml", "has no extrinsics"),
    ("serve --camera door=outer.toml", "has no intrinsics"),
    ("serve --metrics-port a:b", "metrics port 'a:b' is neither PORT nor HOST:PORT"),
    ("serve --metrics-port 70000", "metrics port '70000' is neither"),
    # Nothing listens openly by accident.
    ("router --listen tcp/0.0.0.0:1", "can be reached from other machines"),
    ("serve --listen tcp/0.0.0.0:1", "--insecure"),
    ("serve --metrics-port 0.0.0.0:0", "--insecure"),
    ("source simulator", "which scene"),
    ("source simulator fig9", "no scene 'fig9'"),
    ("source simulator fig4_4 --part 4/3", "part '4/3'"),
    ("source simulator fig4_4 --rate 0", "rate '0'"),
    ("source simulator fig4_4 --rate 1,2 --part 1/3", "2 rates for 3 sources"),
    ("source simulator fig4_4 --start-at soon", "start 'soon'"),
    ("source simulator fig4_4 --time-scale 0", "time scale 0"),
    ("source simulator fig4_4 --noise -1", "--noise"),
    ("source simulator fig4_4 --name A/B", "name 'A/B'"),
    ("source replay take.npz --rate 60", "60 Hz exceeds the 50 Hz"),
    ("source replay take.npz --speed 0", "speed 0"),
    ("source replay take.npz --split 2 --part 1/3", "do not agree"),
    ("source replay none.c3d", "No such file"),
    ("source replay cut.npz", "truncated"),
    ("source klt nope.mp4", "no such file or folder"),
    ("source klt video.avi --calibration wrong.yaml", "wrong.yaml: no camera matrix"),
    ("source klt video.avi --extrinsics inner.toml", "has no [extrinsics]"),
    ("source klt video.avi --tracker windw=3", "unknown tracker parameter 'windw'; one of birth_sigma"),
    ("source klt video.avi --tracker window=1000", "tracker parameter window: "),
    ("source external-camera video.avi --marker-size 0.1", "an external camera needs its extrinsics"),
    ("source external-camera video.avi --marker-size 1 --extrinsics identity", "the camera's intrinsics"),
    ("source external-camera video.avi --marker-size 1 --dictionary 9x9", "'9x9'; one of 4x4_100"),
    ("record take.txt", "ends in .mcap"),
    ("record --out x.mcap", "--out needs"),
    ("record x.mcap --repair y.mcap", "do not record"),
    ("record x.mcap --reserve 1e12", "MiB are to stay free"),
    *((f"{command} {n}.mcap", f"{n}.mcap") for command in OF_RECORDINGS for n in "012"),
    ("evaluate sim:fig4_4 --scene lab", "--scene is only for a running scene, without FILES"),
    ("evaluate --seeds 0-4", "--seeds is only for FILES"),
    ("evaluate sim:fig4_4 --set window=-1", "fusion parameter window"),
    ("evaluate sim:fig4_4 --period 0", "--period"),
    ("evaluate sim:fig4_4 --plot out.xyz", "out.xyz: the name of a picture ends in .png or"),
    ("joints sim:fig4_4 --urdf none/x.urdf", "none: no such folder"),
    ("router --listen nonsense", "'nonsense' is not an address"),
    ("segment video.avi --sheet x.mp4", "x.mp4: the name of a sheet ends in .jpg"),
    ("record none/x.mcap --duration 1", "none: No such file"),
    ("evaluate sim:fig4_4 --duration 0", "--duration 0 is not above 0"),
    ("evaluate sim:fig4_4 --duration 0.05", "too short"),
    ("segment", "name a video, or tracks with --tracks FILE"),
    ("segment text.mp4", "not a readable video"),
    ("dev reproduce --only 9.9", "no figure '9.9'; one of 3.3, 3.4"),
    ("dev reproduce --seeds x", "seeds 'x'"),
    ("dev reproduce --set method=thesis", "compare the default method"),
    ("dev reproduce --out take.npz", "is a file"),
    ("dev reproduce stress --family fall --out out", "no family 'fall'"),
    ("dev reproduce stress --method magic --out out", "magic"),
]


ALL = WRONG + OF_ROBOTS + OF_VIEWERS


@pytest.mark.parametrize(("command", "words"), ALL, ids=[command for command, _ in ALL])
def test_what_cannot_be_done_is_one_line(capsys, monkeypatch, files, command, words):
    if (command, words) in OF_ROBOTS:
        pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")
    if (command, words) in OF_VIEWERS:
        pytest.importorskip("rerun", reason="needs the extra view")
    monkeypatch.chdir(files)
    before = set(files.iterdir())
    assert words in refused(capsys, *shlex.split(command))
    assert set(files.iterdir()) == before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("windw = 3", "unknown common option 'windw'"),
        ("[serv]\nname = 'x'", "unknown table 'serv'"),
        ("[config]\ncolour = 3", "[config] has no option 'colour'"),
        ("[fusion]\nwindw = 3", "unknown fusion parameter 'windw'"),
        ("[fusion", "Expected ']'"),
        ("\x00", "c.toml"),
    ],
)
def test_a_misspelt_file_is_refused(capsys, tmp_path, content, words):
    (tmp_path / "c.toml").write_text(content)
    assert words in refused(capsys, "config", "--config", tmp_path / "c.toml")
