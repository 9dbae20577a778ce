"""Drawing functions for procedural textures: fills, noise, text, logos, bar codes."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Colour = NDArray[np.float64]

_FONT = cv2.FONT_HERSHEY_DUPLEX
INK = (30, 28, 26)
"""Colour of print, BGR."""


def filled(height: int, width: int, colour: Colour) -> Image:
    """Return an image of one colour, uint8 [height, width, 3]."""
    return np.broadcast_to(np.clip(colour, 0, 255).astype(np.uint8), (height, width, 3)).copy()


def clouds(rng: np.random.Generator, height: int, width: int, size: float) -> NDArray[np.float32]:
    """Smooth noise, float32 [height, width] in about -1..1, with features of `size` texels."""
    rows, columns = max(2, int(height / size) + 2), max(2, int(width / size) + 2)
    coarse = rng.uniform(-1, 1, (rows, columns)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))


def shaded(image: Image, gain: NDArray[np.float32]) -> Image:
    """Scale the brightness of an image by 1 + `gain` [height, width]."""
    return np.clip(image * (1.0 + gain)[..., None], 0, 255).astype(np.uint8)


def text(image: Image, words: str, box: tuple[int, int, int, int], colour: tuple[int, ...]) -> None:
    """Draw a line of text that fits into the box (x, y, width, height)."""
    x, y, width, height = box
    (w, h), _ = cv2.getTextSize(words, _FONT, 1.0, 2)
    scale = min(width / w, height / (h + 2))
    if scale > 0.12:
        thickness = max(1, round(scale * 2.2))
        cv2.putText(image, words, (x, y + int(h * scale)), _FONT, scale, colour, thickness, cv2.LINE_AA)


def logo(image: Image, rng: np.random.Generator, centre: tuple[int, int], radius: int) -> None:
    """Draw a disc or ring with a star or polygon in it."""
    ink = tuple(int(v) for v in rng.choice([30, 60, 190, 225], 3))
    kind = int(rng.integers(3))
    cv2.circle(image, centre, radius, ink, -1 if kind == 0 else max(2, radius // 4), cv2.LINE_AA)
    corners = 5 if kind == 0 else int(rng.integers(3, 7))
    angles = np.arange(2 * corners) * np.pi / corners + rng.uniform(0, 1)
    reach = np.where(np.arange(2 * corners) % 2, 0.4, 0.85) * radius
    star = np.stack([centre[0] + reach * np.cos(angles), centre[1] + reach * np.sin(angles)], 1)
    cv2.fillPoly(image, [star.astype(np.int32)], (240, 240, 235), cv2.LINE_AA)


def paragraph(image: Image, rng: np.random.Generator, box: tuple[int, int, int, int]) -> None:
    """Draw lines of illegible words in the box (x, y, width, height)."""
    x, y, width, height = box
    pitch = max(5, height // 6)
    for row in range(y, y + height - pitch // 2, pitch):
        at = x
        while at < x + width * rng.uniform(0.75, 1.0):
            word = int(rng.uniform(0.8, 3.0) * pitch)
            cv2.rectangle(image, (at, row), (min(at + word, x + width), row + pitch // 2), INK, -1)
            at += word + pitch // 2


def barcode(image: Image, rng: np.random.Generator, box: tuple[int, int, int, int]) -> None:
    """Draw a bar code that fills the box (x, y, width, height)."""
    x, y, width, height = box
    cv2.rectangle(image, (x, y), (x + width, y + height), (245, 245, 245), -1)
    at = x + 2
    while at < x + width - 3:
        bar = int(rng.integers(2, 5))
        cv2.rectangle(image, (at, y + 2), (at + bar - 1, y + height - 3), INK, -1)
        at += bar + int(rng.integers(2, 5))
