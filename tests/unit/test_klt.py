"""The tracker on image sequences whose motion is known."""

import cv2
import numpy as np
import pytest

from comotion_sources.calibration.model import Intrinsics
from comotion_sources.cameras.types import Frame
from comotion_sources.klt.config import TrackerConfig
from comotion_sources.klt.template import is_upright
from comotion_sources.klt.tracker import Tracker

SHAPE = (240, 320)
CAMERA = Intrinsics(SHAPE[1], SHAPE[0], 300.0, 300.0, 159.5, 119.5)
PERIOD = 33_333_333


def texture(seed, shape=(400, 480)):
    """Blobs of many sizes: smooth enough for sub-pixel truth, rich in corners."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.normal(size=shape), (0, 0), s) * s for s in (1.5, 3, 6, 12)]
    image = sum(layers)
    return np.asarray(128 + 45 * image / image.std(), np.float32)


def warped(image, matrix):
    """The texture after an affine motion [2, 3] from texture to image pixels."""
    return cv2.warpAffine(image, matrix, SHAPE[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def frame(k, image, rng, noise=1.0, depth=None):
    """Frame k of 30 a second, with noise."""
    seen = np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    return Frame(k * PERIOD, seen, depth)


def places(tracks):
    """Feature to its pixel, float64."""
    return dict(zip(tracks.ids.tolist(), tracks.pixels.astype(float), strict=True))


def motion(k, shift, angle=0.0, zoom=0.0):
    """Frame k of a steady motion: px, rad and share of size per frame, about the image's middle."""
    c, s = np.cos(angle * k) * (1 + zoom * k), np.sin(angle * k) * (1 + zoom * k)
    linear = np.array([[c, -s], [s, c]])
    middle = np.array([SHAPE[1] / 2, SHAPE[0] / 2])
    offset = middle - linear @ middle + np.array(shift) * k - linear @ np.array([80.0, 80.0])
    return np.column_stack([linear, offset])


def moved(points, earlier, later):
    linear, offset = earlier[:, :2], earlier[:, 2]
    texture_points = (points - offset) @ np.linalg.inv(linear).T
    return texture_points @ later[:, :2].T + later[:, 2]


MOTIONS = {
    "still": ((0.0, 0.0), 0.0, 0.0),
    "slow": ((0.37, -0.23), 0.0, 0.0),
    "fast": ((7.3, 4.1), 0.0, 0.0),
    "turning": ((0.5, 0.2), 0.01, 0.0),
    "approaching": ((0.0, 0.0), 0.0, 0.004),
    # Small errors of each step must not add up, nor may turning and shading move a feature.
    "for long": ((0.23, 0.11), 0.004, 0.001),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_features_follow_a_known_motion(name):
    rng, image = np.random.default_rng(3), texture(1)
    tracker = Tracker(TrackerConfig(max_features=120, respawn_every=10))
    poses = [motion(k, *MOTIONS[name]) for k in range(120 if name == "for long" else 25)]
    shade, birth, first = np.linspace(-20, 20, SHAPE[1]) if name == "for long" else 0.0, {}, {}
    for k, matrix in enumerate(poses):
        now = places(tracker.step(frame(k, warped(image, matrix) + shade * k / 120, rng)))
        birth = {feature: (k, pixel) for feature, pixel in now.items()} | birth
        first = first or now
    errors = []
    for feature, pixel in now.items():
        k, begun = birth[feature]
        errors.append(np.linalg.norm(moved(begun, poses[k], poses[-1]) - pixel))
    assert len(first) > 110
    # All that do not leave the image are still there.
    last = moved(np.array([*first.values()]), poses[0], poses[-1])
    inside = ((last > 12) & (last < np.array(SHAPE[::-1]) - 13)).all(axis=1)
    assert np.isin([*first], [*now])[inside].mean() > (0.5 if name == "for long" else 0.9)
    assert np.median(errors) < (0.5 if name == "turning" else 0.25)  # the window turns with the image
    assert np.quantile(errors, 0.95) < 1.0


def crossing(k):
    """A textured board that passes in front of another."""
    scene = warped(texture(1), motion(0, (0, 0)))
    board = texture(7)[:120, :90]
    x = 10 + 6 * k
    scene[60:180, x : x + 90] = board
    return scene


def test_features_end_when_something_passes_in_front_of_them():
    rng, tracker = np.random.default_rng(0), Tracker(TrackerConfig(max_features=200, respawn_every=1000))
    start, ended = places(tracker.step(frame(0, crossing(0), rng))), set()
    for k in range(1, 20):
        tracks = tracker.step(frame(k, crossing(k), rng))
        ended |= set(tracks.ended.tolist())
    behind = {i for i, (x, y) in start.items() if 110 < x < 205 and 70 < y < 170}
    now = places(tracks)
    wandered = [i for i in behind & now.keys() if np.linalg.norm(now[i] - start[i]) > 2]
    assert len(behind & ended) > 0.8 * len(behind) > 12
    assert len(wandered) <= 0.05 * len(start)


def test_only_what_can_be_seen_of_a_surface_that_turns_is_followed():
    warps = np.float32([np.diag(d) for d in [(5, 5), (1, 0.4), (1, 0.3), (1, -1)]])
    assert is_upright(warps).tolist() == [True, True, False, False]


@pytest.mark.parametrize(("birth_sigma", "farthest"), [(None, 1.5), (0.3, 16.0)])
def test_no_feature_goes_along_a_line_with_the_shadow_that_crosses_it(birth_sigma, farthest):
    """A line under a shadow's soft edge is no corner, and what is taken for one ends: the line goes on."""
    rng, y = np.random.default_rng(8), np.arange(SHAPE[0])[:, None]
    floor = np.full(SHAPE, 160.0)
    floor[:, 80::80] = 90.0
    for row in range(20, 220, 50):
        floor[row : row + 5, np.arange(30, SHAPE[1], 80)[:, None] + np.arange(5)] = 40.0
    floor = cv2.GaussianBlur(floor, (0, 0), 1.0)
    tracker, birth = Tracker(TrackerConfig(respawn_every=5, birth_sigma=birth_sigma)), {}
    for k in range(30):
        shadow = 1 - 0.35 / (1 + np.exp((y - 60 - 3 * k) / 4.0))
        for feature, pixel in places(tracker.step(frame(k, floor * shadow, rng, 1.5))).items():
            assert np.linalg.norm(pixel - birth.setdefault(feature, pixel)) < farthest
    assert len(birth) >= 12


def test_ended_features_are_told_once_and_ids_are_never_used_again():
    rng, image = np.random.default_rng(0), texture(4)
    tracker = Tracker(TrackerConfig(max_features=80, respawn_every=3))
    alive, ended = set(), set()
    for k in range(30):
        tracks = tracker.step(frame(k, warped(image, motion(k, (6.0, 3.0))), rng))
        now = set(tracks.ids.tolist())
        assert set(tracks.ended.tolist()) == alive - now
        assert not now & ended
        assert (np.diff(tracks.ids.astype(np.int64)) > 0).all()
        assert set(tracks.ids[tracks.born].tolist()) == now - alive
        ended, alive = ended | (alive - now), now
    assert set(tracker.reset().tolist()) == alive
    assert not set(tracker.step(frame(31, image[:120, :160], rng)).ids.tolist()) & (alive | ended)
    with pytest.raises(ValueError, match="an image of 320 x 240 px follows one of 160 x 120"):
        tracker.step(frame(32, warped(image, motion(0, (0.0, 0.0))), rng))


def test_an_image_may_have_more_corners_than_opencv_samples_at_once():
    noise = np.random.default_rng(0).integers(0, 256, (720, 960)).astype(np.uint8)
    assert len(Tracker(TrackerConfig(distance=1, quality=1e-4)).step(Frame(0, noise)).ids) == 400


def plane(tilt):
    """Depth of a plane: 1/z is linear in the pixel."""
    return np.tile(1 / (1 + tilt * (np.arange(SHAPE[1]) - 160) / 300), (SHAPE[0], 1)).astype(np.float32)


def depth_frames(depths, count):
    rng, image = np.random.default_rng(0), texture(1)
    for k in range(count):
        yield frame(k, warped(image, motion(k, (1.5, 0.0))), rng, depth=depths(k))


def test_points_lie_where_the_camera_saw_them():
    tracker = Tracker(TrackerConfig(max_features=60), CAMERA)
    for frame in depth_frames(lambda k: plane(0.3), 5):
        tracks = tracker.step(frame)
    assert np.isfinite(tracks.positions).all()
    np.testing.assert_allclose(CAMERA.project(tracks.positions), tracks.pixels, atol=1e-3)
    true = 1.0 / (1.0 + 0.3 * (tracks.pixels[:, 0].astype(float) - 160) / 300.0)
    np.testing.assert_allclose(tracks.positions[:, 2], true, rtol=1e-4)
    # Noise grows with the square of the depth, and the far side of the plane is left.
    assert np.corrcoef(tracks.sigma, tracks.positions[:, 2] ** 2)[0, 1] > 0.9


def test_features_outlive_frames_without_depth_but_not_holes_in_it():
    config = TrackerConfig(max_features=60, respawn_every=1000, max_missing=3)
    tracker = Tracker(config, CAMERA)
    hole = plane(0.0)
    hole[:, :160] = 0
    seen = [tracker.step(frame) for frame in depth_frames(lambda k: None if 2 <= k < 12 else plane(0.0), 14)]
    assert np.isnan(seen[5].positions).all()
    assert len(seen[-1].ids) > 0.9 * len(seen[0].ids)
    assert np.isfinite(seen[-1].positions).all()

    tracker = Tracker(config, CAMERA)
    seen = [tracker.step(frame) for frame in depth_frames(lambda k: hole if k >= 2 else plane(0.0), 9)]
    left = set(seen[1].ids[seen[1].pixels[:, 0] < 140].tolist())
    assert left <= set(seen[3].ids.tolist())
    assert not left & set(seen[-1].ids.tolist())
