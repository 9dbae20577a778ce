"""Links between a plain camera's hypotheses and the bodies of a metric space."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig
from comotion.config import Camera
from comotion.linking.reprojection import CameraModel
from comotion_clients.metrics import tracks_of
from comotion_schemas import decode, encode

from ..builders import batch

RATE = 15
BODIES = ("room", "lid", "cart")


def still(t):
    return Rotation.identity(), np.zeros(3)


def lid(t):
    turn = Rotation.from_rotvec([0.2 * np.sin(2 * t), 0, np.sin(1.5 * t)])
    return turn, np.array([-0.4, 0.08 * np.sin(1.3 * t), 0.1 + 0.1 * np.sin(t)])


def cart(t):
    return Rotation.from_rotvec([0, 0, 0.3 * t]), np.array([0.4, -0.45 + 0.16 * t, 0.1])


def camera(**changes):
    """A camera 1.3 m from the scene, looking at it from above."""
    forward = np.array([0.0, 1.0, -0.8]) / np.hypot(1, 0.8)
    right = np.array([1.0, 0.0, 0.0])
    R = np.stack([right, np.cross(forward, right), forward], 1)
    values: dict[str, object] = {
        "fx": 400.0, "fy": 400.0, "cx": 239.5, "cy": 179.5,
        "translation": (0.1, -1.1, 0.9), "quaternion": tuple(Rotation.from_matrix(R).as_quat()),
    }  # fmt: skip
    return Camera(**(values | changes))


def pixels_of(view, points):
    inside = (points - np.asarray(view.translation)) @ CameraModel(view).rotation
    K = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1.0]])
    projected, _ = cv2.projectPoints(
        inside, np.zeros(3), np.zeros(3), K, np.array(view.distortion or [0.0] * 5)
    )
    return np.asarray(projected.reshape(-1, 2))


def shapes(rng, counts):
    """Features of the room, behind the rest, and of two boxes about their own origins."""
    room = rng.uniform([-0.8, 0.35, -0.1], [0.8, 0.8, 0.5], (counts[0], 3))
    return [room, *(rng.uniform(-0.12, 0.12, (n, 3)) for n in counts[1:])]


def messages(view, motions=(still, lid, cart), *, seconds=4.0, seen=None, missing=0.2, start=0.0):
    """What a depth camera and a plain one see: other features of the same bodies, at other instants.

    `seen`: the motions that the plain camera sees, if others. Feature id // 1000 is the body.
    """
    rng = np.random.default_rng(5)
    deep, flat = shapes(rng, (40, 12, 12)), shapes(rng, (40, 14, 14))
    for frame in range(round(start * RATE), round((start + seconds) * RATE)):
        for plain, bodies, moves in ((False, deep, motions), (True, flat, seen or motions)):
            t = (frame + (0.4 if plain else 0.0)) / RATE
            poses = [move(t) for move in moves]
            points = [turn.apply(body) + shift for body, (turn, shift) in zip(bodies, poses, strict=True)]
            x = np.concatenate(points)
            ids = np.concatenate([1000 * k + np.arange(len(body)) for k, body in enumerate(bodies)])
            x = pixels_of(view, x) if plain else x
            x = x + rng.normal(0, 0.2 if plain else 0.003, x.shape)
            here = rng.uniform(size=len(x)) >= missing
            source, space, unit = ("plain", "plain/pixels", "px") if plain else ("deep", "world", "m")
            stamp, seen_ids = round((1000 + t) * 1e9), ids[here].astype(np.uint64)
            yield batch(source, frame, stamp, x[here], ids=seen_ids, space=space, unit=unit)


def run(fusion, batches, every=30):
    for count, arrived in enumerate(batches, 1):
        fusion.ingest(arrived)
        if count % every == 0:
            update = fusion.update(arrived.stamp_ns)
    return fusion.update(arrived.stamp_ns) if count % every else update


def main_body(update):
    """Body of which each hypothesis has most features."""
    votes: dict[int, list[int]] = {}
    for table in tracks_of(update).values():
        for feature, hypothesis in table.items():
            votes.setdefault(hypothesis, []).append(feature // 1000)
    return {h: BODIES[int(np.bincount(given).argmax())] for h, given in votes.items()}


def linked_bodies(update):
    """Body of each linked image hypothesis -> bodies of the hypotheses it is linked to."""
    body = main_body(update)
    projected: dict[str, set[str]] = {}
    for h in update.hypotheses:
        if h.space == "plain/pixels" and h.linked:
            projected.setdefault(body[h.id], set()).update(body[other] for other in h.linked)
    return projected


def fused(view):
    return Fusion(FusionConfig(linking={"cameras": {"plain/pixels": view}}))


@pytest.fixture(scope="module")
def moved():
    fusion = fused(camera())
    run(fusion, messages(camera()))
    return fusion


def test_every_body_is_linked_to_itself_and_both_ways(moved):
    update = Fusion.restore(moved.config, moved.snapshot()).update(1004_000_000_000)
    assert linked_bodies(update) == {name: {name} for name in BODIES}
    of = {h.id: h for h in update.hypotheses}
    for h in update.hypotheses:
        for other in h.linked or ():
            assert of[other].space != h.space
            assert h.id in (of[other].linked or ())
    assert encode(decode(encode(update))) == encode(update)


def test_links_need_motion():
    fusion = fused(camera())
    update = run(fusion, messages(camera(), (still, still, still)))
    assert all(h.linked is None for h in update.hypotheses)


def test_a_link_outlasts_the_motion_and_a_restart(moved):
    """When all motion has left the window, the bodies stay apart and keep their links."""

    def stopped(motion):
        return lambda t: motion(min(t, 4.0))

    fusion = Fusion.restore(FusionConfig(window=2.0, linking=moved.config.linking), moved.snapshot())
    motions = (still, stopped(lid), stopped(cart))
    update = run(fusion, messages(camera(), motions, start=4.0, seconds=2.5))
    assert len({h.id for h in update.hypotheses if h.space == "world"}) == 3
    assert linked_bodies(update) == {name: {name} for name in BODIES}


def test_links_of_another_calibration_are_forgotten(moved):
    for cameras in ({"plain/pixels": camera(frame="elsewhere")}, {"other/pixels": camera()}, {}):
        fusion = Fusion.restore(FusionConfig(linking={"cameras": cameras}), moved.snapshot())
        update = fusion.update(1004_000_000_000)
        assert {h.space for h in update.hypotheses} == {"world", "plain/pixels"}
        assert all(h.linked is None for h in update.hypotheses)


@pytest.mark.parametrize(
    "wrong",
    [
        {"quaternion": tuple(Rotation.from_euler("xyz", [-150, 25, 60], degrees=True).as_quat())},
        {"translation": (1.2, -0.2, 0.9)},
        {"fx": 160.0, "fy": 160.0},
    ],
)
def test_a_wrong_calibration_links_no_moving_body(wrong):
    update = run(fused(camera(**wrong)), messages(camera()), every=60)
    assert linked_bodies(update).keys() <= {"room"}
    assert linked_bodies(update).get("room", set()) <= {"room"}


def test_a_body_that_only_the_plain_camera_sees_move_is_linked_to_none():
    def lift(t):
        return Rotation.from_rotvec([0, 0.3 * t, 0]), np.array([-0.35, 0.0, 0.1 + 0.07 * t])

    update = run(fused(camera()), messages(camera(), (still, still, cart), seen=(still, lift, cart)))
    assert linked_bodies(update) == {"room": {"room"}, "cart": {"cart"}}


def test_distortion_is_undone():
    view = camera(distortion=(-0.3, 0.1, 0.001, -0.002, 0.0))
    assert linked_bodies(run(fused(view), messages(view))) == {name: {name} for name in BODIES}


def test_without_calibration_or_poses_there_are_no_links():
    elsewhere = {"plain/pixels": camera(frame="elsewhere"), "world": camera()}
    cases = ("comotion", {}), ("thesis", {"plain/pixels": camera()}), ("comotion", elsewhere)
    for method, cameras in cases:
        fusion = Fusion(FusionConfig(method=method, linking={"cameras": cameras}))
        update = run(fusion, messages(camera(), seconds=2.0))
        assert all(h.linked is None for h in update.hypotheses)
