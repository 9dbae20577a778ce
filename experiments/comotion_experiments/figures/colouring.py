"""Colours of a run: a hypothesis has the colour of the object it matches best over the whole run."""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from comotion_schemas import UNDETERMINED
from comotion_schemas.colours import GREY, HUES, MARKERS, RGB, colour

from .runs import SeedRun

# The thesis's letters R, G, P, Y, B as the nearest hues of Okabe and Ito.
LETTERS: dict[str, RGB] = {
    "R": (213, 94, 0),
    "G": (0, 158, 115),
    "P": (204, 121, 167),
    "Y": (240, 228, 66),
    "B": (0, 114, 178),
}
Rgb = tuple[float, float, float]
_SURPLUS = MARKERS[1:]


def object_colours(names: Mapping[int, str]) -> dict[int, RGB]:
    """Colour of every true object: of its letter if it has one, else of its number."""
    return {number: LETTERS.get(name, colour(number)) for number, name in names.items()}


class Styles:
    """How the hypotheses of one run are drawn.

    Parameters
    ----------
    run
        The run; hypotheses are assigned to objects one to one over the whole run.
    """

    def __init__(self, run: SeedRun) -> None:
        self.objects = object_colours(run.names)
        self._matched = _match(run.votes)
        self._free = [hue for hue in HUES if hue not in self.objects.values()] or list(HUES)
        others = sorted({h for h, _ in run.votes} - set(self._matched) - {UNDETERMINED})
        self._ranks = {h: rank for rank, h in enumerate(others)}

    def of(self, hypothesis: int) -> tuple[Rgb, str]:
        """Colour and marker of a hypothesis; a surplus one never has a circle."""
        if hypothesis == UNDETERMINED:
            return unit(GREY), "x"
        number = self._matched.get(hypothesis)
        if number is not None:
            return unit(self.objects.get(number, GREY)), "o"
        turn, place = divmod(self._ranks[hypothesis], len(self._free))
        return unit(self._free[place]), _SURPLUS[turn % len(_SURPLUS)]


def unit(rgb: RGB) -> Rgb:
    """Colour in 0..1, as matplotlib wants it."""
    return rgb[0] / 255, rgb[1] / 255, rgb[2] / 255


def _match(votes: Mapping[tuple[int, int], int]) -> dict[int, int]:
    """Object of each hypothesis, by the most shared tracks (Hungarian method)."""
    pairs = {pair: n for pair, n in votes.items() if pair[0] != UNDETERMINED and pair[1] >= 0}
    hypotheses, objects = sorted({h for h, _ in pairs}), sorted({o for _, o in pairs})
    counts = np.zeros((len(hypotheses), len(objects)))
    for (hypothesis, number), count in pairs.items():
        counts[hypotheses.index(hypothesis), objects.index(number)] = count
    rows, columns = linear_sum_assignment(counts, maximize=True)
    return {hypotheses[r]: objects[c] for r, c in zip(rows, columns, strict=True) if counts[r, c]}
