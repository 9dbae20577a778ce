"""What `comotion view` shows of a scene, without anything to show it with."""

import pickle

import numpy as np

from comotion_clients.scoring import SETTLE_S
from comotion_clients.viewing import shapes
from comotion_clients.viewing.cameras import MAX_DELAY_S, MAX_DELAYED, Cameras
from comotion_clients.viewing.features import Features
from comotion_clients.viewing.picture import ScenePicture
from comotion_clients.viewing.shapes import Points
from comotion_schemas import UNDETERMINED, Preview, SourceRef, TruthBatch
from comotion_schemas.colours import GREY, colour

from .. import builders
from ..builders import SESSION, S


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


def one(shapes, kind, path):
    (found,) = [shape for shape in shapes if isinstance(shape, kind) and shape.path == path]
    return found


def flat(moments):
    return [shape for moment in moments for shape in moment.shapes]


def test_a_feature_has_the_colour_of_its_hypothesis_in_every_update():
    features = Features()
    first = one(features.draw(update([3, UNDETERMINED]), {}), Points, "spaces/world/features/a")
    later = one(features.draw(update([UNDETERMINED, 3], 2 * S), {}), Points, "spaces/world/features/a")
    assert first.colours.tolist() == [list(colour(3)), list(GREY)]
    assert later.colours.tolist() == [list(GREY), list(colour(3))]
    assert first.values["feature"].tolist() == [10, 11]


def test_spaces_and_sources_are_drawn_apart_and_taken_away_when_gone():
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
    gone = {shape.path for shape in moment.shapes if isinstance(shape, shapes.Cleared)}
    assert {"spaces/b_pixels/features/b", "spaces/b_pixels/trails"} <= gone
    assert not any(path.startswith("spaces/world") for path in gone)


def test_an_image_waits_for_the_update_that_knows_its_features():
    cameras = Cameras()
    cameras.add(preview(2 * S, [11, 10, 99]), 0.0)
    assert cameras.due(update([1, 2], S), 0.1) == []
    (moment,) = cameras.due(update([1, 2], 2 * S), 0.2)
    assert moment.stamp_ns == 2 * S
    assert one(moment.shapes, shapes.Image, "cameras/a/image").jpeg == b"jpeg"
    points = one(moment.shapes, Points, "cameras/a/features")
    assert points.colours.tolist() == [list(colour(2)), list(colour(1)), list(GREY)]
    assert cameras.due(update([1, 2], 3 * S), 0.3) == []


def test_without_a_service_images_are_shown_grey_and_never_pile_up():
    cameras = Cameras()
    for k in range(MAX_DELAYED + 5):
        cameras.add(preview(k, [10]), 0.0)
    moments = cameras.due(None, MAX_DELAY_S + 0.1)
    assert [m.stamp_ns for m in moments] == list(range(5, MAX_DELAYED + 5))
    assert one(moments[0].shapes, Points, "cameras/a/features").colours.tolist() == [list(GREY)]


def test_at_a_rate_updates_and_images_between_are_left_out_and_events_are_not():
    picture, drawn, images = ScenePicture("lab", rate=5.0), 0, 0
    for k in range(20):
        moments = picture.on_update(update([1, 1], S + k * S // 10), k / 10)
        drawn += any(s.path.startswith("spaces/") for m in moments for s in m.shapes)
        picture.on_preview(preview(S + k * S // 10, [10]), k / 10)
        images += sum(s.path.endswith("/image") for s in flat(picture.tick(k / 10)))
    assert (drawn, images) == (10, 10)


def test_memory_does_not_grow_with_what_has_ended():
    picture, sizes = ScenePicture("lab"), []
    for k in range(1, 400):
        picture.on_batch(batch(seq=k, stamp_ns=k * S), float(k), k * S)
        picture.on_update(update([k], k * S, sources=(f"s{k}",)), float(k))
        picture.tick(k + 0.5)
        sizes.append(len(pickle.dumps(picture)))
    assert (sizes[-1] - sizes[199]) / 199 < 100  # bytes: the path of a source keeps its name


def test_each_space_is_scored_alone():
    picture = ScenePicture("lab")
    for source, space in (("a", "a/pixels"), ("b", "b/pixels")):
        picture.on_batch(batch(source, space, "px", 2), 0.0, S)
        picture.on_truth(TruthBatch(source=source, session=SESSION, ids=[10, 11], objects=[0, 1], names={}))
    # Right in a; in b two objects are one hypothesis. The same objects, seen in two spaces, are no error.
    tracks = {"track_source": [0, 0, 1, 1], "track_id": [10, 11, 10, 11]}
    both = update([1, 2, 3, 3], sources=("a", "b"), **tracks)
    picture.on_update(both, 0.0)
    values = {s.path: s.value for s in flat(picture.tick(2 * SETTLE_S)) if s.path.startswith("scores/")}
    assert (values["scores/a_pixels/nmi"], values["scores/b_pixels/nmi"]) == (1.0, 0.0)
    assert values["scores/b_pixels/wrong"] == 0.5
