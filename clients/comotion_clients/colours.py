"""Colours of hypotheses: hypothesis id -> colour, the same in every client and safe for the colour-blind.

The seven hues are those of Okabe and Ito ("Color Universal Design", 2008) without black. Further ids
repeat the hues in a darker and a lighter shade. With the markers of plots the first 105 ids differ.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED

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
# Dark enough to differ from the reddish purple under deuteranopia.
GREY: RGB = (120, 120, 120)
MARKERS = ("o", "s", "^", "D", "v")
_SHADES = (0.0, -0.35, 0.45)  # share mixed in of black (below 0) or white
_LEGIBLE = (0.45, 0.6)  # range of luma that is legible on black and on white


def colour(hypothesis: int) -> RGB:
    """Colour of a hypothesis id as (red, green, blue) in 0..255; grey for undetermined."""
    if hypothesis == UNDETERMINED:
        return GREY
    red, green, blue = HUES[hypothesis % len(HUES)]
    shade = _SHADES[hypothesis // len(HUES) % len(_SHADES)]
    return _shaded(red, shade), _shaded(green, shade), _shaded(blue, shade)


def legible(hypothesis: int) -> RGB:
    """Colour of a hypothesis id for text on any background: the same hue with medium lightness."""
    red, green, blue = colour(hypothesis)
    luma = (0.2126 * red + 0.7152 * green + 0.0722 * blue) / 255  # Rec. 709
    darkest, lightest = _LEGIBLE
    mix = 0.0
    if luma < darkest:
        mix = (darkest - luma) / (1 - luma)
    elif luma > lightest:
        mix = lightest / luma - 1
    return _shaded(red, mix), _shaded(green, mix), _shaded(blue, mix)


def hex_colour(hypothesis: int) -> str:
    """Colour of a hypothesis id as ``#rrggbb``."""
    red, green, blue = colour(hypothesis)
    return f"#{red:02x}{green:02x}{blue:02x}"


def colours(hypotheses: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Colours uint8 [N, 3] of hypothesis ids [N]."""
    ids, inverse = np.unique(hypotheses, return_inverse=True)
    table = np.array([colour(i) for i in ids.tolist()], np.uint8).reshape(-1, 3)
    return table[inverse]


def marker(hypothesis: int) -> str:
    """Matplotlib marker that distinguishes hypotheses of one colour; a cross for undetermined."""
    return "x" if hypothesis == UNDETERMINED else MARKERS[hypothesis // len(HUES) % len(MARKERS)]


def _shaded(value: int, shade: float) -> int:
    """Mix a value in 0..255 with black (shade below zero) or white."""
    return round(value * (1 + shade)) if shade < 0 else round(value + (255 - value) * shade)
