"""The tracker on image sequences whose motion is known."""

import cv2
import numpy as np
import pytest

from comotion_sources.calibration import Intrinsics
from comotion_sources.cameras import Frame
from comotion_sources.klt import Tracker, TrackerConfig

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


def to_uint8(image, rng, noise=1.0):
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


def motion(k, shift, angle=0.0, zoom=0.0):
    """Frame k of a steady motion: px, rad and share of size per frame, about the image's middle."""
    c, s = np.cos(angle * k) * (1 + zoom * k), np.sin(angle * k) * (1 + zoom * k)
    linear = np.array([[c, -s], [s, c]])
    middle = np.array([SHAPE[1] / 2, SHAPE[0] / 2])
    offset = middle - linear @ middle + np.array(shift) * k - linear @ np.array([80.0, 80.0])
    return np.column_stack([linear, offset])


def moved(points, before, after):
    linear, offset = before[:, :2], before[:, 2]
    texture_points = (points - offset) @ np.linalg.inv(linear).T
    return texture_points @ after[:, :2].T + after[:, 2]


MOTIONS = {
    "still": ((0.0, 0.0), 0.0, 0.0),
    "slow": ((0.37, -0.23), 0.0, 0.0),
    "fast": ((7.3, 4.1), 0.0, 0.0),
    "turning": ((0.5, 0.2), 0.01, 0.0),
    "approaching": ((0.0, 0.0), 0.0, 0.004),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_features_follow_a_known_motion(name):
    rng, image = np.random.default_rng(3), texture(1)
    tracker = Tracker(TrackerConfig(max_features=120, respawn_every=10))
    poses = [motion(k, *MOTIONS[name]) for k in range(25)]
    birth: dict[int, tuple[int, np.ndarray]] = {}
    alive_at_start: set[int] = set()
    for k, matrix in enumerate(poses):
        tracks = tracker.step(Frame(k * PERIOD, to_uint8(warped(image, matrix), rng)))
        for feature, pixel in zip(tracks.ids.tolist(), tracks.pixels.astype(float), strict=True):
            birth.setdefault(feature, (k, pixel))
        if k == 0:
            alive_at_start = set(tracks.ids.tolist())
    errors = [
        np.linalg.norm(moved(birth[feature][1], poses[birth[feature][0]], poses[-1]) - pixel)
        for feature, pixel in zip(tracks.ids.tolist(), tracks.pixels.astype(float), strict=True)
    ]
    assert len(alive_at_start) > 110
    # All that do not leave the image are still there.
    first = np.array([birth[i][1] for i in sorted(alive_at_start)])
    last = moved(first, poses[0], poses[-1])
    inside = ((last > 12) & (last < np.array(SHAPE[::-1]) - 13)).all(axis=1)
    kept = np.isin(sorted(alive_at_start), tracks.ids)
    assert kept[inside].mean() > 0.9
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
    rng = np.random.default_rng(0)
    tracker = Tracker(TrackerConfig(max_features=200, respawn_every=1000))
    first = tracker.step(Frame(0, to_uint8(crossing(0), rng)))
    start = dict(zip(first.ids.tolist(), first.pixels, strict=True))
    ended: set[int] = set()
    for k in range(1, 20):
        tracks = tracker.step(Frame(k * PERIOD, to_uint8(crossing(k), rng)))
        ended |= set(tracks.ended.tolist())
    behind = {i for i, (x, y) in start.items() if 110 < x < 205 and 70 < y < 170}
    left = [(i, pixel) for i, pixel in zip(tracks.ids.tolist(), tracks.pixels, strict=True) if i in behind]
    wandered = [i for i, pixel in left if np.linalg.norm(pixel - start[i]) > 2]
    assert len(behind) > 15
    assert len(behind & ended) > 0.8 * len(behind)
    assert len(wandered) <= 0.05 * len(start)


def test_features_stay_on_their_spot_however_long_they_live():
    """Small errors of each step must not add up, nor may turning and shading move a feature."""
    rng, image = np.random.default_rng(7), texture(5)
    tracker = Tracker(TrackerConfig(max_features=80, respawn_every=1000))
    poses = [motion(k, (0.23, 0.11), 0.004, 0.001) for k in range(120)]
    ramp = np.linspace(-20, 20, SHAPE[1])
    for k, matrix in enumerate(poses):
        tracks = tracker.step(Frame(k * PERIOD, to_uint8(warped(image, matrix) + ramp * k / 120, rng, 2.0)))
        if k == 0:
            birth = dict(zip(tracks.ids.tolist(), tracks.pixels.astype(float), strict=True))
    true = moved(np.array([birth[i] for i in tracks.ids.tolist()]), poses[0], poses[-1])
    errors = np.linalg.norm(tracks.pixels - true, axis=1)
    assert len(errors) > 40
    assert np.quantile(errors, 0.9) < 0.3


def test_no_feature_goes_along_a_line_with_the_shadow_that_crosses_it():
    """A line under a shadow's soft edge looks like a corner, but nothing of it is fixed to the surface."""
    rng, y = np.random.default_rng(8), np.arange(SHAPE[0])[:, None]
    floor = np.full(SHAPE, 160.0)
    floor[:, 80::80] = 90.0
    for row in range(20, 220, 50):
        floor[row : row + 5, np.arange(30, SHAPE[1], 80)[:, None] + np.arange(5)] = 40.0
    floor = cv2.GaussianBlur(floor, (0, 0), 1.0)
    tracker = Tracker(TrackerConfig(respawn_every=5))
    birth: dict[int, np.ndarray] = {}
    for k in range(30):
        shadow = 1 - 0.35 / (1 + np.exp((y - 60 - 3 * k) / 4.0))
        tracks = tracker.step(Frame(k * PERIOD, to_uint8(floor * shadow, rng, 1.5)))
        for feature, pixel in zip(tracks.ids.tolist(), tracks.pixels.astype(float), strict=True):
            assert np.linalg.norm(pixel - birth.setdefault(feature, pixel)) < 1.5
    assert len(birth) >= 12


def test_ended_features_are_told_once_and_ids_are_never_used_again():
    rng, image = np.random.default_rng(0), texture(4)
    tracker = Tracker(TrackerConfig(max_features=80, respawn_every=3))
    alive: set[int] = set()
    ended: set[int] = set()
    for k in range(30):
        tracks = tracker.step(Frame(k * PERIOD, to_uint8(warped(image, motion(k, (6.0, 3.0))), rng)))
        now = set(tracks.ids.tolist())
        assert set(tracks.ended.tolist()) == alive - now
        assert not now & ended
        assert (np.diff(tracks.ids.astype(np.int64)) > 0).all()
        assert {i for i, born in zip(tracks.ids.tolist(), tracks.born, strict=True) if born} == now - alive
        ended |= set(tracks.ended.tolist())
        alive = now
    assert set(tracker.reset().tolist()) == alive
    after = tracker.step(Frame(31 * PERIOD, to_uint8(image[:120, :160], rng)))
    assert not set(after.ids.tolist()) & (alive | ended)


def plane(tilt, near=1.0):
    """Depth of a plane: 1/z is linear in the pixel."""
    x = np.arange(SHAPE[1], dtype=np.float64)
    row = 1.0 / (1.0 / near + tilt * (x - 160) / 300.0)
    return np.tile(row, (SHAPE[0], 1)).astype(np.float32)


def depth_frames(depths, count):
    rng, image = np.random.default_rng(0), texture(1)
    for k in range(count):
        yield Frame(k * PERIOD, to_uint8(warped(image, motion(k, (1.5, 0.0))), rng), depths(k))


def test_points_lie_where_the_camera_saw_them():
    tracker = Tracker(TrackerConfig(max_features=60), CAMERA)
    for frame in depth_frames(lambda k: plane(0.3), 5):
        tracks = tracker.step(frame)
    assert tracks.points is not None
    assert tracks.sigma is not None
    assert np.isfinite(tracks.points).all()
    np.testing.assert_allclose(CAMERA.project(tracks.points), tracks.pixels, atol=1e-3)
    true = 1.0 / (1.0 + 0.3 * (tracks.pixels[:, 0].astype(float) - 160) / 300.0)
    np.testing.assert_allclose(tracks.points[:, 2], true, rtol=1e-4)
    # Noise grows with the square of the depth, and the far side of the plane is left.
    assert np.corrcoef(tracks.sigma, tracks.points[:, 2] ** 2)[0, 1] > 0.9


def test_a_step_in_depth_ends_the_features_on_it():
    tracker = Tracker(TrackerConfig(max_features=60, respawn_every=1000, max_step=0.05), CAMERA)

    def depths(k):
        depth = plane(0.0)
        if k >= 3:
            depth[:, :160] = 0.6
        return depth

    *_, before, _, after = [tracker.step(frame) for frame in depth_frames(depths, 5)]
    left = set(before.ids[before.pixels[:, 0] < 150].tolist())
    right = set(before.ids[before.pixels[:, 0] > 170].tolist())
    assert left
    assert not left & set(after.ids.tolist())
    assert len(right & set(after.ids.tolist())) > 0.9 * len(right)


def test_features_outlive_frames_without_depth_but_not_holes_in_it():
    config = TrackerConfig(max_features=60, respawn_every=1000, max_missing=3)
    tracker = Tracker(config, CAMERA)
    hole = plane(0.0)
    hole[:, :160] = 0

    seen = [tracker.step(frame) for frame in depth_frames(lambda k: None if 2 <= k < 12 else plane(0.0), 14)]
    assert seen[5].points is not None
    assert np.isnan(seen[5].points).all()
    assert len(seen[-1].ids) > 0.9 * len(seen[0].ids)
    assert np.isfinite(seen[-1].points).all()

    tracker.reset()
    tracker = Tracker(config, CAMERA)
    seen = [tracker.step(frame) for frame in depth_frames(lambda k: hole if k >= 2 else plane(0.0), 9)]
    left = set(seen[1].ids[seen[1].pixels[:, 0] < 140].tolist())
    assert left <= set(seen[3].ids.tolist())
    assert not left & set(seen[-1].ids.tolist())
