"""Dense regions from sparse labels: a mask per hypothesis that ends at edges of the image.

Regions grow from the labelled features and meet where the image changes most (watershed, Meyer 1992, of
OpenCV). A body has features wherever it has texture; so what is farther from all features of a body than
these are from one another belongs to the background, the hypothesis whose features have the largest extent.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NOBODY = -1
# Longer edge of the image that regions grow on, px: one of this size takes some 15 ms.
_EDGE_PX = 640
# Blur of the image, and half the side of the square that a feature is a seed of, px.
_BLUR_PX, _SEED_PX = 1.0, 1
# Reach of a body beyond its features: times the distance to the second neighbour that most of them have.
_REACH, _MOST_HAVE = 2.5, 0.75

Floats = NDArray[np.float64]


def regions(
    image: NDArray[np.uint8], pixels: NDArray[np.float32], labels: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Label every pixel of an image.

    Parameters
    ----------
    image
        uint8 [H, W, 3] or [H, W].
    pixels
        float32 [N, 2], features.
    labels
        int64 [N], their hypotheses; negative for none, which are left out.

    Returns
    -------
    int64 [H, W]; :data:`NOBODY` everywhere without labelled features.
    """
    height, width = image.shape[:2]
    inside = (pixels >= 0).all(axis=1) & (pixels < [width, height]).all(axis=1)
    labelled = (labels >= 0) & inside
    names, index = np.unique(labels[labelled], return_inverse=True)
    if len(names) < 2:
        return np.full((height, width), names[0] if len(names) else NOBODY, np.int64)
    scale = min(_EDGE_PX / max(height, width), 1.0)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
    if small.ndim == 2:
        small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    places = np.minimum(pixels[labelled] * scale, [small.shape[1] - 1, small.shape[0] - 1])
    seeds = _seeds(small.shape[:2], places, index)
    grown = cv2.watershed(small, seeds)
    # Where regions meet there is a line of -1, and one around the image: it goes to a neighbour.
    beside = cv2.dilate(grown.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int32)
    coarse = names[np.where(grown > 0, grown, beside) - 1].astype(np.int32)
    full = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(full, np.int64)


def _seeds(shape: tuple[int, ...], places: Floats, index: NDArray[np.intp]) -> NDArray[np.int32]:
    """What is certain, int32 [H, W]: 1 + index of a hypothesis; 0 elsewhere.

    Squares around features, and the background where no feature of another hypothesis is near.
    """
    bodies = [places[index == k] for k in range(int(index.max()) + 1)]
    background = int(np.argmax([np.ptp(body, axis=0).prod() for body in bodies]))
    seeds, open_ = np.zeros(shape, np.int32), np.zeros(shape, np.bool_)
    for k, body in enumerate(bodies):
        if k != background:
            open_ |= _near(shape, body)
    seeds[~open_] = background + 1
    # Bodies last: they have fewer features than the background.
    for k in sorted(range(len(bodies)), key=lambda body: body != background):
        for x, y in bodies[k].astype(int).tolist():
            rows, columns = (slice(max(v - _SEED_PX, 0), v + _SEED_PX + 1) for v in (y, x))
            seeds[rows, columns] = k + 1
    return seeds


def _near(shape: tuple[int, ...], places: Floats) -> NDArray[np.bool_]:
    """Pixels within the reach of a body's features [n, 2], bool [H, W]."""
    away = np.full(shape, 255, np.uint8)
    away[places[:, 1].astype(int), places[:, 0].astype(int)] = 0
    # The second neighbour, if there are as many.
    apart, _ = cKDTree(places).query(places, k=[min(3, len(places))])
    reach = _REACH * np.quantile(apart, _MOST_HAVE)
    return np.asarray(cv2.distanceTransform(away, cv2.DIST_L2, 3) < reach)
