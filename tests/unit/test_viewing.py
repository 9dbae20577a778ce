"""What `comotion view` shows of a scene, as Rerun is given it, and the errors before anything opens."""

import pickle
import socket
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_schemas import UNDETERMINED, Box, Event, Pose, Preview, SourceRef, TruthBatch, Twist, encode
from comotion_schemas.colours import GREY, Palette, colour

from .. import builders
from ..builders import SESSION, S, hypothesis
from ..command_line import refused

rerun = pytest.importorskip("rerun", reason="needs the extra view")

from comotion_clients.scoring import SETTLE_S  # noqa: E402
from comotion_clients.viewing import sink  # noqa: E402
from comotion_clients.viewing.features import MAX_DELAY_S, MAX_DELAYED, Cameras, Features  # noqa: E402
from comotion_clients.viewing.hypotheses import BodyDrawing  # noqa: E402
from comotion_clients.viewing.picture import ScenePicture  # noqa: E402

rerun.set_strict_mode(True)
DRAWING = BodyDrawing("p", (0.0, 0.0, 1.0), 0.5, Palette())


def update(labels, stamp_ns=S, sources=("a",), **fields):
    """One track per label, ids 10, 11, ...; all of the first source unless told otherwise."""
    usual = {
        "seq": stamp_ns // S,
        "sources": [SourceRef(name=name, session=SESSION) for name in sources],
        "track_id": 10 + np.arange(len(labels)),
    }
    return builders.update(labels, stamp_ns=stamp_ns, **(usual | fields))


def batch(source="a", space="world", unit="m", dim=3, **fields):
    usual = {"stamp_ns": S, "ids": [10, 11], "positions": np.zeros((2, dim))}
    return builders.batch(source, space=space, unit=unit, **(usual | fields))


def preview(stamp_ns, ids):
    pixels = np.arange(2 * len(ids), dtype=np.float32).reshape(-1, 2)
    picture = {"encoding": "jpeg", "image": b"jpeg", "ids": ids, "pixels": pixels}
    return Preview(source="a", session=SESSION, stamp_ns=stamp_ns, **picture)


def drawn_at(shapes, path):
    (drawn,) = [shape.drawn for shape in shapes if shape.path == path]
    return drawn


def values(drawn, name):
    """What is logged as one component of Rerun's, as NumPy has it."""
    return np.array(getattr(drawn, name).as_arrow_array().to_pylist())


def colours(drawn):
    """Colours as (red, green, blue)."""
    return [[c >> 24, c >> 16 & 255, c >> 8 & 255] for c in values(drawn, "colors").tolist()]


def send(picture, *messages, arrived=0.0):
    for message in messages:
        picture.on_message(message, arrived, S)
    moments, picture.moments = picture.moments, []
    return moments


def flat(moments):
    return [shape for moment in moments for shape in moment.shapes]


def test_a_feature_has_the_colour_of_its_hypothesis_in_every_update():
    features = Features(Palette(), {})
    first, ids = drawn_at(features.draw(update([3, UNDETERMINED]), {}), "spaces/world/features/a")
    later, _ = drawn_at(features.draw(update([UNDETERMINED, 3], 2 * S), {}), "spaces/world/features/a")
    assert colours(first) == [list(colour(3)), list(GREY)]
    assert colours(later) == [list(GREY), list(colour(3))]
    logged = {str(b.component_descriptor()): b.as_arrow_array() for b in ids.as_component_batches()}
    assert [ids.to_pylist() for name, ids in logged.items() if "feature" in name] == [[10, 11]]


def test_spaces_and_sources_are_drawn_apart_and_taken_away_when_gone():
    picture = ScenePicture("lab")
    both = update([1, 2], sources=("a", "b"), track_source=[0, 1])
    send(picture, batch("a"), batch("b", "b/pixels", "px", 2), both)
    assert {(v.path, v.name, v.axes) for v in picture.layout.spaces} == {
        ("spaces/world", "world", "z-up"),
        ("spaces/b_pixels", "b/pixels", "image"),
    }
    (moment,) = send(picture, update([1], 2 * S))
    gone = {shape.path for shape in moment.shapes if isinstance(shape.drawn[0], rerun.Clear)}
    assert {"spaces/b_pixels/features/b", "spaces/b_pixels/trails"} <= gone
    assert not any(path.startswith("spaces/world") for path in gone)


def test_labels_stand_above_their_bodies_and_none_covers_another():
    box = Box(center=[0.0, 0.0, 1.0], half=[0.1, 0.1, 0.4], rotation=[0.0, 0.0, 0.0, 1.0])
    bodies = [hypothesis(k, centroid=[0.1 * k, 0.0, 1.0], box=box) for k in range(4)]
    far = hypothesis(9, centroid=[50.0, 0.0, 1.0], state="static")
    (words,) = drawn_at(DRAWING.bodies([*bodies, far]), "p/hypotheses")
    heights = values(words, "positions")[:, 2]
    assert heights[0] == pytest.approx(1.4)
    assert np.diff(np.sort(heights[:4])) == pytest.approx(0.4, abs=1e-5)
    assert heights[4] == pytest.approx(1.0)


def test_bodies_have_boxes_and_what_is_at_rest_has_none():
    half = float(np.sqrt(0.5))  # 90 degrees about z
    box = Box(center=[1.0, 2.0, 3.0], half=[0.3, 0.2, 0.1], rotation=[0.0, 0.0, half, half])
    bodies = [hypothesis(4, box=box), hypothesis(5, box=box, state="static"), hypothesis(6)]
    (shape,) = drawn_at(DRAWING.bodies(bodies), "p/boxes")
    assert values(shape, "centers").tolist() == [[1, 2, 3]]
    assert colours(shape) == [list(colour(4))]
    np.testing.assert_allclose(values(shape, "quaternions"), [[0, 0, half, half]], atol=1e-6)


def test_an_image_waits_for_the_update_that_knows_its_features():
    cameras = Cameras(Palette(), {})
    cameras.add(preview(2 * S, [11, 10, 99]), 0.0)
    assert cameras.due(update([1, 2], S), 0.1) == []
    (moment,) = cameras.due(update([1, 2], 2 * S), 0.2)
    assert moment.stamp_ns == 2 * S
    assert values(*drawn_at(moment.shapes, "cameras/a/image"), "blob").ravel().tolist() == list(b"jpeg")
    assert colours(drawn_at(moment.shapes, "cameras/a/features")[0]) == [
        list(colour(2)),
        list(colour(1)),
        list(GREY),
    ]
    assert cameras.due(update([1, 2], 3 * S), 0.3) == []


def test_without_a_service_images_are_shown_grey_and_never_pile_up():
    cameras = Cameras(Palette(), {})
    for k in range(MAX_DELAYED + 5):
        cameras.add(preview(k, [10]), 0.0)
    moments = cameras.due(None, MAX_DELAY_S + 0.1)
    assert [m.stamp_ns for m in moments] == list(range(5, MAX_DELAYED + 5))
    assert colours(drawn_at(moments[0].shapes, "cameras/a/features")[0]) == [list(GREY)]


def test_at_a_rate_updates_and_images_between_are_left_out_and_events_are_not():
    picture, drawn, images = ScenePicture("lab", rate=5.0), 0, 0
    for k in range(20):
        moments = send(picture, update([1, 1], S + k * S // 10), arrived=k / 10)
        drawn += any(s.path.startswith("spaces/") for m in moments for s in m.shapes)
        send(picture, preview(S + k * S // 10, [10]), arrived=k / 10)
        images += sum(s.path.endswith("/image") for s in flat(picture.tick(k / 10)))
    assert (drawn, images) == (10, 10)


def test_memory_does_not_grow_with_what_has_ended():
    picture, sizes = ScenePicture("lab"), []
    for k in range(1, 400):
        send(picture, batch(seq=k, stamp_ns=k * S), update([k], k * S, sources=(f"s{k}",)), arrived=float(k))
        picture.tick(k + 0.5)
        sizes.append(len(pickle.dumps(picture)))
    assert (sizes[-1] - sizes[199]) / 199 < 100  # bytes: the path of a source keeps its name


def test_each_space_is_scored_alone():
    picture = ScenePicture("lab")
    for source, space in (("a", "a/pixels"), ("b", "b/pixels")):
        truth = TruthBatch(source=source, session=SESSION, ids=[10, 11], objects=[0, 1], names={})
        send(picture, batch(source, space, "px", 2), truth)
    # Right in a; in b two objects are one hypothesis. The same objects, seen in two spaces, are no error.
    tracks = {"track_source": [0, 0, 1, 1], "track_id": [10, 11, 10, 11]}
    both = update([1, 2, 3, 3], sources=("a", "b"), **tracks)
    send(picture, both)
    scores = {s.path: s.drawn[0] for s in flat(picture.tick(2 * SETTLE_S)) if s.path.startswith("scores/")}
    latest = {path: values(drawn, "scalars").item() for path, drawn in scores.items()}
    assert (latest["scores/a_pixels/nmi"], latest["scores/b_pixels/nmi"]) == (1.0, 0.0)
    assert latest["scores/b_pixels/wrong"] == 0.5


def test_without_the_extra_the_command_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert refused(capsys, "view", "--web") == "error: rerun is not installed: pip install 'comotion[view]'"


def test_without_a_display_the_command_says_what_to_do(monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert "use --web (browser) or --save FILE.rrd" in refused(capsys, "view")


def test_an_endpoint_that_is_wrong_leaves_no_file(tmp_path, capsys):
    refused(capsys, "view", "--save", tmp_path / "a.rrd", "--tls", tmp_path / "none")
    assert not list(tmp_path.iterdir())


def test_page_and_data_are_for_this_machine_alone():
    page, data = sink.free_port(), sink.free_port()
    with sink.RerunSink(web_port=page, data_port=data) as shown:
        assert str(page) in shown.url
        # Of every listening socket: local address and state, see proc_net_tcp.
        lines = [Path("/proc/net", name).read_text().splitlines()[1:] for name in ("tcp", "tcp6")]
        sockets = [line.split() for line in lines[0] + lines[1]]
        addresses = {s[1].split(":")[0] for s in sockets if int(s[1].split(":")[1], 16) in {page, data}}
    assert addresses == {"0100007F"}


@pytest.mark.parametrize("taken", ["web_port", "data_port"])
def test_a_port_in_use_is_an_error_that_names_it(taken):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        ports = {"web_port": sink.free_port(), "data_port": sink.free_port(), taken: port}
        with pytest.raises(OSError, match=str(port)), sink.RerunSink(**ports):
            pass


def test_every_shape_of_a_recording_arrives_in_the_file(tmp_path, capsys):
    pytest.importorskip("mcap")
    import rerun_cli

    from comotion_clients.recording.file import RecordingFile

    with RecordingFile(tmp_path / "a.mcap", scene="lab") as file:
        for k in range(1, 6):
            for key, message in recorded(k).items():
                file.add(f"comotion/@v1/lab/{key}", k * S, encode(message), message)
    assert run(["view", str(tmp_path / "a.mcap"), "--save", str(tmp_path / "a.rrd")]) == 0
    assert "5 updates" in capsys.readouterr().err
    command = [Path(rerun_cli.__file__).with_name("rerun"), "rrd", "print", "-v", tmp_path / "a.rrd"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    expected = [
        "/cameras/a/image", "/cameras/a/features", "/lags/a", "/legend/dots", "/log", "/rates/a",
        "/scores/plane/nmi", "/sizes/1", "/spaces/plane/features/a", "/spaces/plane/frames", "/summary",
        "/spaces/plane/hypotheses", "/spaces/plane/trails", "/spaces/plane/twist/linear",
    ]  # fmt: skip
    assert [path for path in expected if path not in text] == []


def recorded(k):
    """Messages of second k by their keys."""
    image = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    jpeg = {"encoding": "jpeg", "image": image, "ids": [10], "pixels": [[1, 2]]}
    pose, twist = Pose(translation=[0.0, 0.0], rotation=0.1), Twist(linear=[1.0, 0.0], angular=1.0)
    update = builders.update(
        [1, UNDETERMINED],
        seq=k,
        stamp_ns=k * S,
        track_id=[10, 11],
        track_position=np.array([[k, k, np.nan]] * 2, np.float32),
        hypotheses=[hypothesis(1, space="plane", centroid=[float(k), float(k)], pose=pose, twist=twist)],
        events=[Event(stamp_ns=k * S, kind="born", hypothesis=1, others=[])],
    )
    return {
        "obs/a": builders.batch("a", k, k * S, np.full((2, 2), k), space="plane", ids=[10, 11]),
        "truth/a": TruthBatch(source="a", session=SESSION, ids=[10, 11], objects=[0, 1], names={}),
        "preview/a": Preview(source="a", session=SESSION, stamp_ns=k * S, **jpeg),
        "hypotheses": update,
    }
