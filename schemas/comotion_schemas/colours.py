"""Gives hypotheses colours, the same in every tool and safe for the colour-blind.

The first seven hues are those of Okabe and Ito ("Color Universal Design", 2008) without black. Each further
one was chosen from a grid of colours to be as far as possible from all before it, for people with normal
vision, protanopia, deuteranopia and tritanopia.
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .hypotheses import Hypothesis
from .types import UNDETERMINED

RGB: TypeAlias = tuple[int, int, int]

# Ordered so that the first few differ most in lightness and hue.
HUES: tuple[RGB, ...] = (
    (0, 114, 178),  # blue
    (230, 159, 0),  # orange
    (0, 158, 115),  # bluish green
    (204, 121, 167),  # reddish purple
    (86, 180, 233),  # sky blue
    (213, 94, 0),  # vermilion
    (240, 228, 66),  # yellow
)
COLOURS: tuple[RGB, ...] = (
    *HUES,
    (153, 0, 238),  # violet
    (119, 68, 34),  # brown
    (0, 255, 136),  # mint
    (153, 119, 255),  # lavender
    (170, 238, 187),  # pale green
    (119, 170, 85),  # olive
    (153, 0, 119),  # plum
    (85, 68, 187),  # indigo
    (153, 68, 0),  # rust
    (221, 187, 85),  # sand
)
"""Colours of bodies; no two are close, nor close to the greys."""
GREY: RGB = (110, 110, 110)
"""Undetermined features."""
BACKGROUND: RGB = (180, 180, 180)
"""What is at rest around the bodies."""
MARKERS = ("o", "s", "^", "D", "v")
_LEGIBLE = (0.45, 0.6)  # range of luma that is legible on black and on white


class Palette:
    """Gives each hypothesis of a scene a colour of its own for as long as updates list it.

    The background of a space is light grey: the largest hypothesis at rest when it is first seen, or in 2-D
    one whose box is the largest, as with a camera that moves. Each other one gets the colour that goes with
    its id, or if another one has that, the next free one. If there are more hypotheses than colours, colours
    repeat. A colour changes only if what was taken for the background moves.
    """

    def __init__(self) -> None:
        self._given: dict[int, RGB] = {}

    def see(self, hypotheses: Sequence[Hypothesis]) -> None:
        """Take in all hypotheses that an update lists."""
        listed = {h.id: h for h in hypotheses}
        behind = {h.id for h in hypotheses if _is_behind(h, hypotheses)}
        self._given = {
            number: rgb
            for number, rgb in self._given.items()
            if number in listed and (rgb != BACKGROUND or number in behind)
        }
        new = [h for h in hypotheses if h.id not in self._given]
        have = {listed[number].space for number, rgb in self._given.items() if rgb == BACKGROUND}
        # A hypothesis at rest goes before one that is not known to be, and a larger one before a smaller.
        for h in sorted(new, key=lambda h: (h.state == "static", h.size), reverse=True):
            if h.id in behind and h.space not in have:
                have.add(h.space)
                self._given[h.id] = BACKGROUND
        for h in sorted(new, key=lambda h: h.id):
            if h.id not in self._given:
                used, first = list(self._given.values()), h.id % len(COLOURS)
                self._given[h.id] = min((*COLOURS[first:], *COLOURS[:first]), key=used.count)

    def colour(self, hypothesis: int) -> RGB:
        """Colour of a hypothesis id as (red, green, blue) in 0..255; grey for undetermined."""
        return self._given.get(hypothesis) or colour(hypothesis)

    def legible(self, hypothesis: int) -> RGB:
        """Colour of a hypothesis id for text on any background."""
        return legible(self.colour(hypothesis))

    def colours(self, hypotheses: NDArray[np.uint32]) -> NDArray[np.uint8]:
        """Colours uint8 [N, 3] of hypothesis ids uint32 [N]."""
        ids, inverse = np.unique(hypotheses, return_inverse=True)
        table = np.array([self.colour(i) for i in ids.tolist()], np.uint8).reshape(-1, 3)
        return table[inverse]


def _is_behind(body: Hypothesis, listed: Sequence[Hypothesis]) -> bool:
    """Whether it can be the background of its space: at rest, or in 2-D the one with the largest box."""
    if body.state != "moving":
        return True
    others = [h for h in listed if h.space == body.space and h.id != body.id and not h.absent]
    return len(body.centroid) == 2 and bool(others) and all(_area(body) > _area(h) for h in others)


def _area(body: Hypothesis) -> float:
    return 0.0 if body.box is None else math.prod(body.box.half)


def colour(hypothesis: int) -> RGB:
    """Colour that goes with a hypothesis id, whatever else there is; grey for undetermined."""
    return GREY if hypothesis == UNDETERMINED else COLOURS[hypothesis % len(COLOURS)]


def legible(rgb: RGB) -> RGB:
    """A colour for text on any background: mixed with black or white until it has medium lightness."""
    shares = np.array(rgb) / 255
    luma = shares @ (0.2126, 0.7152, 0.0722)  # Rec. 709
    wanted = np.clip(luma, *_LEGIBLE)
    mixed = shares * wanted / luma if wanted <= luma else 1 - (1 - shares) * (1 - wanted) / (1 - luma)
    red, green, blue = np.rint(255 * mixed).astype(int).tolist()
    return red, green, blue


def as_hex(rgb: RGB) -> str:
    """A colour as ``#rrggbb``."""
    red, green, blue = rgb
    return f"#{red:02x}{green:02x}{blue:02x}"


def marker(hypothesis: int) -> str:
    """Matplotlib marker that distinguishes hypotheses of one colour; a cross for undetermined."""
    return "x" if hypothesis == UNDETERMINED else MARKERS[hypothesis // len(COLOURS) % len(MARKERS)]
