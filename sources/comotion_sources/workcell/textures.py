"""Procedural textures of real materials: wood, printed cartons, painted sheet metal, toy blocks.

A texture is an image of one face of a body. It is drawn once with OpenCV from the size of the face in
metres, its colour and a seeded generator. Faces have edges, print and grain, so that a feature tracker
finds corners as on real objects.
"""

from collections.abc import Callable

import cv2
import numpy as np

from .drawing import INK, Colour, Image, barcode, clouds, filled, logo, paragraph, shaded, text

Texture = Callable[[np.random.Generator, int, int, Colour, float], Image]
"""(generator, height, width in texels, BGR colour 0..255, texels per metre) -> uint8 [height, width, 3]."""

_WORDS = ("ACME", "FRAGILE", "PARTS", "No 7", "TOOLS", "ROBO", "LAB 3", "GEAR", "MK II", "BOLTS", "M8x40")
_TITLES = ("KINEMATICS", "VISION", "MOTION", "LINEAR MAPS", "OPTICS", "ATLAS", "ESTIMATION", "DESIGN")


def plain(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Paint with faint unevenness."""
    return shaded(filled(height, width, colour), 0.04 * clouds(rng, height, width, 0.05 * scale))


def planks(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Boards with grain, knots and butt joints, along the height.

    On the table the boards are across the direction of motion; otherwise features slide along the
    joints between boards with an object that crosses them.
    """
    return np.ascontiguousarray(np.rot90(_boards(rng, width, height, colour, scale)))


def _boards(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    image, seam = filled(height, width, colour), tuple((colour * 0.5).tolist())
    board = max(8, int(0.11 * scale))
    for top in range(0, height, board):
        bottom, left = min(top + board, height), 0
        while left < width:
            right = min(width, left + int(rng.uniform(0.35, 0.8) * scale) + 1)
            image[top:bottom, left:right] = _board(rng, bottom - top, right - left, colour, scale)
            cv2.line(image, (right, top), (right, bottom), seam, 1)
            left = right
        cv2.line(image, (0, top), (width, top), seam, 2)
    return image


def _board(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / scale
    bend = 0.012 * clouds(rng, height, width, 0.16 * scale)
    distance = y + bend + rng.uniform(0, 1)
    for _ in range(rng.integers(0, 3)):  # a knot pushes the rings apart
        kx, ky = rng.uniform(0, width / scale), rng.uniform(0, height / scale)
        r2 = ((x - kx) / 2.2) ** 2 + (y - ky) ** 2
        distance = distance + 0.02 * np.exp(-r2 / 0.012**2) * np.sign(y - ky + 1e-6)
    rings = np.sin(distance * 2 * np.pi / 0.012) + 0.5 * np.sin(distance * 2 * np.pi / 0.0047 + 1.0)
    fibres = clouds(rng, height, max(2, width // 24), 1.5)
    fibres = np.asarray(cv2.resize(fibres, (width, height), interpolation=cv2.INTER_LINEAR))
    gain = 0.075 * rings + 0.10 * fibres + rng.uniform(-0.12, 0.12)
    return shaded(filled(height, width, colour), gain.astype(np.float32))


def wood(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """One solid board with a darker edge."""
    if height > width:
        return np.ascontiguousarray(wood(rng, width, height, colour, scale).transpose(1, 0, 2))
    image = _board(rng, height, width, colour, scale)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), tuple((colour * 0.55).tolist()), 2)
    return image


def tiles(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Floor tiles, some with an ornament."""
    image = filled(height, width, colour * 0.6)
    size = int(0.25 * scale)
    for top in range(0, height, size):
        for left in range(0, width, size):
            tone = np.clip(colour * rng.uniform(0.82, 1.12), 0, 255).tolist()
            cv2.rectangle(image, (left + 2, top + 2), (left + size - 2, top + size - 2), tone, -1)
            if rng.random() < 0.35:
                logo(image, rng, (left + size // 2, top + size // 2), size // 3)
    return shaded(image, 0.06 * clouds(rng, height, width, 0.03 * scale))


def wallpaper(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """A wall with a skirting line, posters, a notice board and a socket or two."""
    image = plain(rng, height, width, colour, scale)
    for line in range(0, width, int(0.3 * scale)):
        cv2.line(image, (line, 0), (line, height), tuple((colour * 0.93).tolist()), 1)
    for left in np.arange(0.08, width / scale - 0.3, 0.55):
        for top in np.arange(0.15, height / scale - 0.45, 0.62):
            w, h = int(rng.uniform(0.24, 0.42) * scale), int(rng.uniform(0.28, 0.5) * scale)
            x, y = int((left + rng.uniform(0, 0.1)) * scale), int((top + rng.uniform(0, 0.08)) * scale)
            h, w = min(h, height - y), min(w, width - x)
            if w > 20 and h > 20:
                image[y : y + h, x : x + w] = poster(rng, h, w, rng.uniform(120, 235, 3), scale)
    return image


def poster(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """A sheet with a headline, a picture of coloured shapes and lines of small print."""
    image = plain(rng, height, width, colour, scale)
    text(image, str(rng.choice(_WORDS)), (width // 12, height // 16, width * 5 // 6, height // 7), INK)
    top, bottom = height // 4, height * 5 // 8
    for _ in range(7):
        x, y = int(rng.uniform(0.1, 0.9) * width), int(rng.uniform(top, bottom))
        tone, r = rng.uniform(20, 230, 3).tolist(), max(2, int(rng.uniform(0.05, 0.16) * width))
        if rng.random() < 0.5:
            cv2.circle(image, (x, y), r, tone, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(image, (x - r, y - r), (x + r, y + r // 2), tone, -1)
    paragraph(image, rng, (width // 12, height * 2 // 3, width * 5 // 6, height // 4))
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), INK, 1)
    return image


def print_(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """A printed carton: frame, brand, logo, bar code and a stripe of the contents."""
    image = plain(rng, height, width, colour, scale)
    ink = tuple((255 - colour * 0.9).tolist())
    margin = max(2, min(height, width) // 14)
    cv2.rectangle(image, (margin, margin), (width - margin, height - margin), ink, max(1, margin // 3))
    inner_w, inner_h = width - 4 * margin, height - 4 * margin
    if inner_w < 16 or inner_h < 16:
        return image
    word = str(rng.choice(_WORDS))
    text(image, word, (2 * margin, 2 * margin, inner_w, max(8, inner_h // 3)), ink)
    radius = max(3, min(inner_w, inner_h) // 5)
    logo(image, rng, (2 * margin + radius, height - 2 * margin - radius), radius)
    barcode(
        image,
        rng,
        (2 * margin + inner_w // 2, height - 2 * margin - inner_h // 3, inner_w // 2, inner_h // 3),
    )
    stripe = np.clip(rng.uniform(30, 220, 3), 0, 255).tolist()
    middle = 2 * margin + int(inner_h * 0.42)
    cv2.rectangle(image, (margin, middle), (width - margin, middle + max(2, inner_h // 9)), stripe, -1)
    return image


def paint(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Painted sheet metal of a toy: panel lines, rivets, a window or a number, a stripe."""
    image = plain(rng, height, width, colour, scale)
    dark, light = tuple((colour * 0.45).tolist()), tuple(np.clip(colour * 0.4 + 150, 0, 255).tolist())
    step = max(10, int(0.035 * scale))
    for x in range(step // 2, width, step):
        cv2.line(image, (x, 0), (x, height), dark, 1)
        for y in (height // 10, height - height // 10):
            cv2.circle(image, (x, y), max(1, step // 12), light, -1, cv2.LINE_AA)
    cv2.rectangle(image, (0, int(height * 0.62)), (width, int(height * 0.74)), light, -1)
    x, y, w, h = width // 6, height // 5, width * 2 // 5, height // 3
    cv2.rectangle(image, (x, y), (x + w, y + h), (90, 70, 50), -1)
    cv2.line(image, (x + w // 5, y + h), (x + w // 2, y), (200, 190, 170), 2, cv2.LINE_AA)
    cv2.rectangle(image, (x, y), (x + w, y + h), INK, 2)
    text(image, str(rng.integers(10, 99)), (width * 2 // 3, y, width // 4, h), (240, 240, 240))
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), dark, 2)
    return image


def letters(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """A toy block: a rim, a letter in a contrasting square, dots in the corners."""
    image = wood(rng, height, width, colour, scale)
    rim = max(2, min(height, width) // 9)
    face = np.clip(colour * 0.3 + rng.uniform(110, 180, 3), 0, 255).tolist()
    cv2.rectangle(image, (rim, rim), (width - rim, height - rim), face, -1)
    cv2.rectangle(image, (rim, rim), (width - rim, height - rim), INK, max(1, rim // 3))
    side = min(height, width) - 4 * rim
    letter = chr(ord("A") + int(rng.integers(26)))
    text(image, letter, ((width - side * 3 // 4) // 2, (height - side) // 2, side, side), INK)
    for x in (2 * rim, width - 2 * rim):
        for y in (2 * rim, height - 2 * rim):
            cv2.circle(image, (x, y), max(1, rim // 2), rng.uniform(20, 200, 3).tolist(), -1, cv2.LINE_AA)
    return image


def hazard(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Machine housing: a band of warning stripes, screws and a type plate."""
    image = plain(rng, height, width, colour, scale)
    band, pitch = max(4, height // 5), max(8, int(0.024 * scale))
    for x in range(-band - pitch, width, 2 * pitch):
        quad = np.array([[x, band], [x + pitch, band], [x + pitch + band, 0], [x + band, 0]])
        cv2.fillPoly(image, [quad], (20, 190, 235), cv2.LINE_AA)
        cv2.fillPoly(image, [quad + np.array([pitch, 0])], (25, 25, 25), cv2.LINE_AA)
    plate = (width // 6, height * 2 // 5, width * 2 // 3, height // 3)
    cv2.rectangle(image, plate[:2], (plate[0] + plate[2], plate[1] + plate[3]), (225, 225, 220), -1)
    text(image, str(rng.choice(_WORDS)), (plate[0] + 2, plate[1] + 2, plate[2] - 4, plate[3] - 4), INK)
    for x in (width // 12, width - width // 12):
        for y in (band + height // 10, height - height // 12):
            cv2.circle(image, (x, y), max(2, int(0.004 * scale)), (60, 60, 60), -1, cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (40, 40, 40), 1)
    return image


def brushed(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Brushed metal with graduation marks every 2 cm and a label now and then."""
    streaks = np.asarray(cv2.resize(clouds(rng, height, 2, 1.5), (width, height)))
    image = shaded(filled(height, width, colour), 0.08 * streaks)
    step = max(6, int(0.02 * scale))
    for count, y in enumerate(range(step // 2, height, step)):
        reach = width if count % 5 == 0 else width // 3
        cv2.line(image, (0, y), (reach, y), INK, 1 + (count % 5 == 0))
        if count % 5 == 2:
            text(image, str(count), (width // 3, y - step // 2, width // 3, step), INK)
    return image


def rubber(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """A dark tread with a light hub."""
    image = plain(rng, height, width, colour, scale)
    centre, radius = (width // 2, height // 2), min(height, width) // 2
    cv2.circle(image, centre, radius * 3 // 5, (190, 190, 195), -1, cv2.LINE_AA)
    cv2.circle(image, centre, radius // 5, (60, 60, 60), -1, cv2.LINE_AA)
    return image


def books(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """A row of spines with titles, upright."""
    image, left = filled(height, width, colour * 0.3), 0
    while left < width:
        right = min(width, left + max(8, int(rng.uniform(0.018, 0.04) * scale)))
        spine = plain(rng, right - left, height, rng.uniform(40, 220, 3), scale)
        ink = (245, 240, 230) if spine.mean() < 130 else INK
        size = (height // 8, (right - left) // 5, height * 3 // 4, (right - left) * 3 // 5)
        text(spine, str(rng.choice(_TITLES)), size, ink)
        cv2.line(spine, (height // 14, 0), (height // 14, height), ink, 2)
        image[:, left:right] = np.rot90(spine, -1)
        cv2.line(image, (right - 1, 0), (right - 1, height), INK, 1)
        left = right
    return image


def plaid(rng: np.random.Generator, height: int, width: int, colour: Colour, scale: float) -> Image:
    """Woven cloth with stripes in both directions."""
    image = filled(height, width, colour).astype(np.float32)
    for _ in range(6):
        tone, at, w = rng.uniform(-70, 70, 3), rng.uniform(0, 0.06), rng.uniform(0.004, 0.012)
        for axis, size in ((0, height), (1, width)):
            stripe = ((np.arange(size) / scale - at) % 0.06) < w
            image += tone * (stripe[:, None, None] if axis == 0 else stripe[None, :, None])
    return np.clip(image, 0, 255).astype(np.uint8)


_OF_ROOMS = (plain, planks, tiles, wallpaper, poster, books, plaid)
_OF_THINGS = (wood, print_, paint, letters, hazard, brushed, rubber)
TEXTURES: dict[str, Texture] = {draw.__name__.rstrip("_"): draw for draw in (*_OF_ROOMS, *_OF_THINGS)}
"""MJCF material name -> texture."""
