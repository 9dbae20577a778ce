"""Dense regions from labelled features."""

import cv2
import numpy as np

from comotion_clients.regions import regions
from comotion_experiments.labelled import Labelled
from comotion_experiments.masks import MaskFolder
from comotion_sources.cameras.types import Frame
from comotion_sources.klt import Tracks


def picture():
    """A bright disc on a dark ground, and the true object of each pixel."""
    y, x = np.mgrid[0:120, 0:160]
    disc = (x - 90) ** 2 + (y - 50) ** 2 < 30**2
    rng = np.random.default_rng(0)
    image = np.where(disc, 180, 60)[..., None] + rng.normal(0, 6, (120, 160, 3))
    return image.clip(0, 255).astype(np.uint8), disc.astype(np.int32)


def overlap(one, other):
    """Intersection over union of two masks."""
    return (one & other).sum() / (one | other).sum()


def test_regions_end_at_the_edges_of_the_image():
    image, true = picture()
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [159, 119], (60, 2)).astype(np.float32)
    labels = np.where(true[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] == 1, 7, 3)
    labels[:5] = -1
    found = regions(image, pixels, labels)
    assert set(np.unique(found)) == {3, 7}
    assert overlap(found == 3, true == 0) > 0.95
    assert overlap(found == 7, true == 1) > 0.9


def test_a_wall_without_features_is_not_the_bodys_that_is_nearest():
    image = np.full((120, 160, 3), 90, np.uint8)
    image[40:80, 10:50] = 200
    on_body = np.random.default_rng(0).uniform([14, 44], [46, 76], (20, 2))
    background = np.array([[x, y] for x in (4, 60, 155) for y in (4, 60, 115)])
    pixels = np.vstack([on_body, background]).astype(np.float32)
    true = np.zeros((120, 160), np.int32)
    true[40:80, 10:50] = 1
    found = regions(image, pixels, np.repeat([7, 3], [20, 9]))
    assert overlap(found == 7, true == 1) > 0.9


def test_one_wrong_feature_has_no_region_of_its_own():
    image, true = picture()
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [159, 119], (120, 2)).astype(np.float32)
    labels = np.where(true[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] == 1, 7, 3)
    pixels[-1], labels[-1] = (10, 110), 7
    found = regions(image, pixels, labels)
    assert not (found[90:, :30] == 7).any()
    assert overlap(found == 7, true == 1) > 0.9


def test_masks_hold_the_hypothesis_of_every_pixel(tmp_path):
    image, _ = picture()
    pixels = np.array([[5, 5], [90, 50]], np.float32)
    labels = np.array([1, 300])
    tracks = Tracks(**dict.fromkeys(Tracks.__dataclass_fields__) | {"pixels": pixels})
    folder = MaskFolder(tmp_path / "masks", 0.5)
    for k in range(7):
        frame = Frame(k * 100_000_000, image)
        folder.write(Labelled(k, frame, tracks, labels, np.ones(2), []))
    assert sorted(path.name for path in (tmp_path / "masks").iterdir()) == ["000000.png", "000005.png"]
    found = cv2.imread(str(tmp_path / "masks" / "000005.png"), cv2.IMREAD_UNCHANGED)
    assert found.dtype == np.uint16
    assert (found == regions(image, pixels, labels)).all()
