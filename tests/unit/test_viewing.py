"""What `comotion view` shows of a scene, without anything to show it with."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest

from comotion_clients.scoring import SETTLE_S, SpaceRef
from comotion_clients.viewing.cameras import MAX_DELAY_S, MAX_DELAYED, Cameras
from comotion_clients.viewing.features import Features
from comotion_clients.viewing.hypotheses import draw_hypotheses
from comotion_clients.viewing.paths import Paths, plain
from comotion_clients.viewing.picture import ScenePicture
from comotion_clients.viewing.shapes import (
    Arrows,
    Boxes,
    Cleared,
    Document,
    Entry,
    Image,
    Moment,
    Number,
    Points,
    Regions,
    Segments,
    Shape,
)
from comotion_clients.viewing.trails import LONGEST_GAP_NS, Trails
from comotion_schemas import UNDETERMINED, Box, Event, Pose, Preview, SourceRef, TruthBatch, Twist
from comotion_schemas.colours import COLOURS, GREY, Palette, colour, legible

from .. import builders
from ..builders import SESSION, S, hypothesis


def update(labels: list[int], stamp_ns: int = S, sources: tuple[str, ...] = ("a",), **fields):
    """One track per label, ids 10, 11, ...; all of the first source unless told otherwise."""
    usual = {
        "seq": stamp_ns // S,
        "sources": [SourceRef(name=name, session=SESSION) for name in sources],
        "track_id": 10 + np.arange(len(labels)),
    }
    return builders.update(labels, stamp_ns=stamp_ns, **(usual | fields))


def batch(source: str = "a", space: str = "world", unit: str = "m", dim: int = 3, **fields):
    usual = {"stamp_ns": S, "ids": [10, 11], "positions": np.zeros((2, dim))}
    return builders.batch(source, space=space, unit=unit, **(usual | fields))


def preview(stamp_ns: int, ids: list[int]) -> Preview:
    pixels = np.arange(2 * len(ids), dtype=np.float32).reshape(-1, 2)
    return Preview(
        source="a", session=SESSION, stamp_ns=stamp_ns, encoding="jpeg", image=b"jpeg", ids=ids, pixels=pixels
    )


def one(shapes: list[Shape], kind: type, path: str) -> Shape:
    (found,) = [shape for shape in shapes if isinstance(shape, kind) and shape.path == path]
    return found


def flat(moments: list[Moment]) -> list[Shape]:
    return [shape for moment in moments for shape in moment.shapes]


def test_a_feature_has_the_colour_of_its_hypothesis_in_every_update() -> None:
    features = Features()
    first = one(features.draw(update([3, UNDETERMINED]), {}), Points, "spaces/world/features/a")
    later = one(features.draw(update([UNDETERMINED, 3], 2 * S), {}), Points, "spaces/world/features/a")
    assert first.colours.tolist() == [list(colour(3)), list(GREY)]
    assert later.colours.tolist() == [list(GREY), list(colour(3))]
    assert first.values["feature"].tolist() == [10, 11]


def test_spaces_and_sources_are_drawn_apart_and_taken_away_when_gone() -> None:
    picture = ScenePicture("lab")
    picture.on_batch(batch("a"), 0.0, S)
    picture.on_batch(batch("b", "b/pixels", "px", 2), 0.0, S)
    both = update([1, 2], sources=("a", "b"), track_source=[0, 1])
    picture.on_update(both, 0.0)
    assert {(v.path, v.name, v.axes) for v in picture.layout.spaces} == {
        ("spaces/world", "world", "z-up"),
        ("spaces/b_pixels", "b/pixels", "image"),
    }
    (moment,) = picture.on_update(update([1], 2 * S), 0.1)
    gone = {shape.path for shape in moment.shapes if isinstance(shape, Cleared)}
    assert {"spaces/b_pixels/features/b", "spaces/b_pixels/trails"} <= gone
    assert not any(path.startswith("spaces/world") for path in gone)


def test_a_plane_in_metres_has_y_up_and_an_optical_frame_is_seen_as_one() -> None:
    features = Features()
    known = {"a": SpaceRef("plane", "m", 2), "b": SpaceRef("cam/optical", "m", 3)}
    features.draw(update([1, 2], sources=("a", "b"), track_source=[0, 1]), known)
    assert {v.name: v.axes for v in features.views.values()} == {"plane": "y-up", "cam/optical": "optical"}


def test_a_trail_joins_the_same_feature_and_nothing_else() -> None:
    trails = Trails()
    positions = np.array([[0, 0], [1, 1], [2, 2]], np.float32)
    rows, ends = trails.step("s", 1 * S // 10, np.array([5, 7, 6], np.uint64), positions)
    assert len(rows) == len(ends) == 0
    rows, ends = trails.step("s", 2 * S // 10, np.array([6, 9, 5], np.uint64), positions + 10)
    assert rows.tolist() == [0, 2]
    assert ends.tolist() == [[[2, 2], [10, 10]], [[0, 0], [12, 12]]]


@pytest.mark.parametrize(("key", "stamp_ns"), [("t", 2), ("s", 1), ("s", 2 + LONGEST_GAP_NS)])
def test_a_trail_begins_anew_in_another_session_backwards_and_after_a_gap(key: str, stamp_ns: int) -> None:
    trails, ids, positions = Trails(), np.array([5], np.uint64), np.zeros((1, 3), np.float32)
    trails.step("s", 1, ids, positions)
    rows, ends = trails.step(key, stamp_ns, ids, positions)
    assert len(rows) == 0
    assert ends.shape == (0, 2, 3)


def test_trails_have_the_colours_of_now() -> None:
    features = Features()
    features.draw(update([1, 2]), {})
    shapes = features.draw(update([2, 2], S + S // 10, track_position=np.ones((2, 3), np.float32)), {})
    trail = one(shapes, Segments, "spaces/world/trails")
    assert trail.ends.tolist() == [[[0, 0, 0], [1, 1, 1]]] * 2
    assert trail.colours.tolist() == [list(colour(2))] * 2


def test_frames_turn_with_the_body_in_3d() -> None:
    half = float(np.sqrt(0.5))  # 90 degrees about z
    turned = hypothesis(
        4, centroid=[1.0, 2.0, 3.0], pose=Pose(translation=[0.0, 0.0, 0.0], rotation=[0.0, 0.0, half, half])
    )
    shapes = draw_hypotheses("p", [turned, hypothesis(5)], 0.5, Palette())
    frames = one(shapes, Arrows, "p/frames")
    assert frames.origins.tolist() == [[1, 2, 3]] * 3
    assert frames.vectors == pytest.approx(np.array([[0, 0.5, 0], [-0.5, 0, 0], [0, 0, 0.5]]), abs=1e-6)
    assert one(shapes, Points, "p/hypotheses").labels == ("4 moving", "5 moving")


def test_bodies_have_boxes_and_what_is_at_rest_has_none() -> None:
    half = float(np.sqrt(0.5))  # 90 degrees about z
    box = Box(center=[1.0, 2.0, 3.0], half=[0.3, 0.2, 0.1], rotation=[0.0, 0.0, half, half])
    bodies = [hypothesis(4, box=box), hypothesis(5, box=box, state="static"), hypothesis(6)]
    found = one(draw_hypotheses("p", bodies, 0.5, Palette()), Boxes, "p/boxes")
    assert found.centers.tolist() == [[1, 2, 3]]
    assert found.colours.tolist() == [list(colour(4))]
    np.testing.assert_allclose(found.turns[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)


def test_twist_arrows_show_the_way_of_a_second_and_the_axis() -> None:
    moving = hypothesis(4, twist=Twist(linear=[0.3, 0.0, 0.0], angular=[0.0, 0.0, 2.0]))
    racing = hypothesis(5, twist=Twist(linear=[0.0, 9.0, 0.0], angular=[100.0, 0.0, 0.0]))
    resting = hypothesis(6, twist=Twist(linear=[0.001, 0.0, 0.0], angular=[0.0, 0.0, 0.01]))
    shapes = draw_hypotheses("p", [moving, racing, resting, hypothesis(7)], 0.5, Palette())
    linear, angular = one(shapes, Arrows, "p/twist/linear"), one(shapes, Arrows, "p/twist/angular")
    assert linear.vectors == pytest.approx(np.array([[0.3, 0, 0], [0, 2.0, 0]]))  # at most four axes long
    assert linear.colours.tolist() == [list(colour(4)), list(colour(5))]
    assert angular.vectors == pytest.approx(np.array([[0, 0, 1.0], [2.0, 0, 0]]))


def test_in_2d_a_turn_is_the_way_of_the_tip_of_the_x_axis() -> None:
    turning = hypothesis(
        1,
        space="plane",
        centroid=[1.0, 1.0],
        pose=Pose(translation=[0.0, 0.0], rotation=np.pi / 2),
        twist=Twist(linear=[0.0, 0.0], angular=-1.0),
    )
    spin = one(draw_hypotheses("p", [turning], 0.5, Palette()), Arrows, "p/twist/angular")
    assert spin.origins == pytest.approx(np.array([[1.0, 1.5]]))
    assert spin.vectors == pytest.approx(np.array([[0.5, 0.0]]))


def test_an_image_waits_for_the_update_that_knows_its_features() -> None:
    cameras = Cameras()
    cameras.add(preview(2 * S, [11, 10, 99]), 0.0)
    assert cameras.due(update([1, 2], S), 0.1) == []
    (moment,) = cameras.due(update([1, 2], 2 * S), 0.2)
    assert moment.stamp_ns == 2 * S
    assert one(moment.shapes, Image, "cameras/a/image").jpeg == b"jpeg"
    points = one(moment.shapes, Points, "cameras/a/features")
    assert points.colours.tolist() == [list(colour(2)), list(colour(1)), list(GREY)]
    assert cameras.due(update([1, 2], 3 * S), 0.3) == []


def test_regions_of_hypotheses_are_drawn_over_the_image_on_request() -> None:
    image = np.full((40, 60, 3), 30, np.uint8)
    image[:, 30:] = 200
    seen = preview(S, list(range(10, 40)))
    places = np.array([[x, y] for x in range(3, 60, 6) for y in (8, 20, 32)], np.float32)
    cameras = Cameras(dense=True)
    cameras.add(replace(seen, image=cv2.imencode(".jpg", image)[1].tobytes(), pixels=places), 0.0)
    (moment,) = cameras.due(update([1] * 15 + [2] * 15), 0.1)
    shape = one(moment.shapes, Regions, "cameras/a/regions")
    left, right = shape.classes[20, 5], shape.classes[20, 55]
    assert (shape.classes[:, :28] == left).all()
    assert (shape.classes[:, 32:] == right).all()
    assert [shape.colours[k] for k in (left, right)] == [tuple(colour(1)), tuple(colour(2))]


def test_an_image_that_cannot_be_read_has_no_regions() -> None:
    cameras = Cameras(dense=True)
    cameras.add(preview(S, [10]), 0.0)
    (moment,) = cameras.due(update([1]), 0.1)
    assert not [shape for shape in moment.shapes if isinstance(shape, Regions)]


def test_without_a_service_images_are_shown_grey_and_never_pile_up() -> None:
    cameras = Cameras()
    for k in range(MAX_DELAYED + 5):
        cameras.add(preview(k, [10]), 0.0)
    moments = cameras.due(None, MAX_DELAY_S + 0.1)
    assert [m.stamp_ns for m in moments] == list(range(5, MAX_DELAYED + 5))
    assert one(moments[0].shapes, Points, "cameras/a/features").colours.tolist() == [list(GREY)]


def test_a_camera_with_a_wrong_clock_does_not_drag_the_time_line_along() -> None:
    cameras = Cameras()
    cameras.add(preview(1000 * S, [10]), 0.0)
    (moment,) = cameras.due(update([1], S), MAX_DELAY_S + 0.1)
    assert moment.stamp_ns == S


def test_pixels_that_are_seen_in_images_need_no_view_of_their_own() -> None:
    picture = ScenePicture("lab")
    picture.on_batch(batch("a", "a/pixels", "px", 2), 0.0, S)
    picture.on_update(update([1, 1]), 0.0)
    assert [view.name for view in picture.layout.spaces] == ["a/pixels"]
    picture.on_preview(preview(S, [10, 11]), 0.0)
    picture.tick(0.1)
    assert picture.layout.spaces == ()
    assert [view.name for view in picture.layout.cameras] == ["a"]


def test_at_a_rate_updates_and_images_between_are_left_out_and_events_are_not() -> None:
    picture, drawn, images = ScenePicture("lab", rate=5.0), 0, 0
    for k in range(20):
        moments = picture.on_update(update([1, 1], S + k * S // 10), k / 10)
        drawn += any(s.path.startswith("spaces/") for m in moments for s in m.shapes)
        picture.on_preview(preview(S + k * S // 10, [10]), k / 10)
        images += sum(s.path.endswith("/image") for s in flat(picture.tick(k / 10)))
    assert (drawn, images) == (10, 10)


def test_nmi_is_shown_where_there_is_truth() -> None:
    picture = ScenePicture("lab")
    picture.on_batch(batch(), 0.0, S)
    picture.on_update(update([1, 2]), 0.0)
    assert not any(s.path.startswith("scores/") for s in flat(picture.tick(SETTLE_S)))
    assert not picture.layout.scored
    picture.on_truth(TruthBatch(source="a", session=SESSION, ids=[10, 11], objects=[0, 1], names={}))
    picture.on_batch(batch(stamp_ns=2 * S, seq=1), 1.0, 2 * S)
    picture.on_update(update([1, 2], 2 * S), 1.0)
    assert not any(s.path.startswith("scores/") for s in flat(picture.tick(1.0)))
    moments = [m for m in picture.tick(1.01 + SETTLE_S) if m.shapes[0].path == "scores/world/nmi"]
    assert [(m.stamp_ns, m.shapes[0].value) for m in moments] == [(2 * S, 1.0)]
    assert picture.layout.scored


def test_an_update_that_repeats_its_stamp_is_not_drawn_again_but_its_events_are_told() -> None:
    picture = ScenePicture("lab")
    assert picture.on_update(update([1]), 0.0)
    assert picture.on_update(update([1]), 0.1) == []
    born = Event(stamp_ns=S, kind="split", hypothesis=7, others=[1])
    (moment,) = picture.on_update(update([1], events=[born]), 0.2)
    assert moment.shapes == [Entry("log", "hypothesis 7 split from 1", colour=legible(colour(7)))]


def test_stalls_and_losses_are_logged_once() -> None:
    picture = ScenePicture("lab")

    def entries(now: float) -> list[str]:
        return [shape.text for shape in flat(picture.tick(now)) if isinstance(shape, Entry)]

    for k, seq in enumerate((0, 1, 2, 6)):
        picture.on_batch(batch(seq=seq), k / 10, S)
    picture.on_update(update([1]), 0.3)
    assert entries(0.4) == ["service is ok", "source a is live: in world", "3 lost of a"]
    assert entries(0.5) == []
    picture.on_update(update([1], 2 * S), 4.9)
    assert entries(5.0) == ["source a is stalled: in world"]
    assert entries(20.0) == ["service is silent"]


def test_curves_carry_the_colours_of_the_features() -> None:
    picture = ScenePicture("lab")
    picture.on_update(update([8, 8, UNDETERMINED], hypotheses=[hypothesis(8, size=2)]), 0.0)
    shapes = flat(picture.tick(0.1))
    assert one(shapes, Number, "sizes/8") == Number("sizes/8", 2, "hypothesis 8", colour(8))
    assert one(shapes, Number, "sizes/undetermined").value == 1
    assert one(shapes, Points, "legend/words").labels == ("8 moving, 2",)
    assert "Data of **00:00:01 UTC**" in one(shapes, Document, "summary").text
    assert one(shapes, Points, "legend/dots").colours.tolist() == [list(colour(8))]


def test_memory_does_not_grow_with_what_has_ended() -> None:
    picture, sizes = ScenePicture("lab"), []
    for k in range(1, 400):
        picture.on_batch(batch(seq=k, stamp_ns=k * S), float(k), k * S)
        picture.on_update(update([k], k * S, sources=(f"s{k}",)), float(k))
        picture.tick(k + 0.5)
        sizes.append(len(pickle.dumps(picture)))
    assert (sizes[-1] - sizes[199]) / 199 < 100  # bytes: the path of a source keeps its name


def test_every_name_has_a_path_of_its_own() -> None:
    paths = Paths("spaces")
    names = ["a/b", "a_b", "a b", "", "ü" * 300, "../../x"]
    found = [paths(name) for name in names]
    assert len(set(found)) == len(names)
    assert found == [paths(name) for name in names]
    assert all(path.count("/") == 1 and path.isascii() and len(path) < 80 for path in found)
    assert plain("naïve 🟦") == "naïve ?"


def test_words_are_legible_on_dark_and_on_light() -> None:
    for shade in [*COLOURS, GREY]:
        red, green, blue = legible(shade)
        assert 0.44 < (0.2126 * red + 0.7152 * green + 0.0722 * blue) / 255 < 0.61


def test_before_there_is_a_time_nothing_is_drawn_and_old_stamps_are_no_lag() -> None:
    picture = ScenePicture("lab")
    assert picture.on_update(update([], 0), 0.0) == []
    assert picture.tick(0.1) == []
    picture.on_batch(batch(), 1.0, 10**18)
    picture.on_update(update([1]), 1.0)
    paths = {shape.path: moment.stamp_ns for moment in picture.tick(1.1) for shape in moment.shapes}
    assert set(paths.values()) == {S}
    assert "lags/a" not in paths
    assert "lags/.service" in paths


def test_each_space_is_scored_alone() -> None:
    picture = ScenePicture("lab")
    for source, space in (("a", "a/pixels"), ("b", "b/pixels")):
        picture.on_batch(batch(source, space, "px", 2), 0.0, S)
        picture.on_truth(TruthBatch(source=source, session=SESSION, ids=[10, 11], objects=[0, 1], names={}))
    # Right in a; in b two objects are one hypothesis. The same objects, seen in two spaces, are no error.
    both = update(
        [1, 2, 3, 3],
        sources=("a", "b"),
        track_source=[0, 0, 1, 1],
        track_id=[10, 11, 10, 11],
    )
    picture.on_update(both, 0.0)
    values = {s.path: s.value for s in flat(picture.tick(2 * SETTLE_S)) if s.path.startswith("scores/")}
    assert values["scores/a_pixels/nmi"] == 1.0
    assert values["scores/b_pixels/nmi"] == 0.0
    assert values["scores/b_pixels/wrong"] == 0.5
