"""Colours of a run: a hypothesis has the colour of the object it matches best over the whole run."""

from collections.abc import Mapping

from comotion_schemas import UNDETERMINED
from comotion_schemas.colours import BACKGROUND, GREY, HUES, MARKERS, RGB, colour

from ..plot import Rgb, unit
from ..trace import matched
from .runs import SeedRun

# The thesis's letters G, P, Y, B as the nearest hues of Okabe and Ito. R is its background: grey.
LETTERS: dict[str, RGB] = {
    "R": BACKGROUND,
    "G": (0, 158, 115),
    "P": (204, 121, 167),
    "Y": (240, 228, 66),
    "B": (0, 114, 178),
}
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
        self._matched = matched(run.votes)
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
