"""The animation of the README is small, and keeps colours apart; the gallery has the code of its picture."""

import cv2
import numpy as np

from comotion_experiments.pictures import affinity_code, from_frames
from comotion_schemas.colours import COLOURS


def test_the_animation_is_small_and_its_colours_stay_apart(tmp_path):
    rng, images = np.random.default_rng(0), []
    for _ in range(24):
        image = cv2.GaussianBlur(rng.integers(0, 120, (240, 320, 3), np.uint8), (0, 0), 3)
        for number, (red, green, blue) in enumerate(COLOURS):
            cv2.circle(image, (10 + 18 * number, 100), 7, (blue, green, red), -1)
        images.append(np.asarray(image, np.uint8))
    still, moving = from_frames(tmp_path, images)
    assert moving.stat().st_size < 1_000_000
    ok, animation = cv2.imreadanimation(str(moving))
    assert ok
    assert len(animation.frames) == 7
    for picture in (animation.frames[-1], cv2.imread(str(still))):
        dots = picture[100, [10 + 18 * number for number in range(len(COLOURS))], 2::-1].astype(int)
        away = np.linalg.norm(dots[:, None] - np.array(COLOURS)[None], axis=2)
        assert away.argmin(axis=1).tolist() == list(range(len(COLOURS)))


def test_the_gallery_has_the_code_that_draws_the_affinities():
    assert compile(affinity_code(), "gallery.md", "exec")
