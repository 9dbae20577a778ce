"""Options for dividing one scene or recording among several sources: parts and rates."""

from collections.abc import Sequence
from dataclasses import dataclass

from comotion_schemas.errors import KnownError


@dataclass(frozen=True)
class Part:
    """Source number `index` (from 0) of `count` sources."""

    index: int = 0
    count: int = 1


def parse_part(text: str) -> Part:
    """Parse ``k/n``: the k-th of n sources, counted from 1.

    Raises
    ------
    ValueError
        If the text does not have this form.
    """
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second) <= 64:
        return Part(int(first) - 1, int(second))
    raise KnownError(f"part {text!r} is not K/N with 1 <= K <= N <= 64, e.g. 2/3")


def parse_rates(text: str) -> list[float]:
    """Parse rates in Hz, separated by commas.

    Raises
    ------
    ValueError
        If a rate is not a number above 0 and at most 1000.
    """
    try:
        rates = [float(chunk) for chunk in text.split(",")]
    except ValueError:
        rates = []
    if not rates or not all(0 < rate <= 1000 for rate in rates):
        raise KnownError(f"rate {text!r} is not one or several numbers from 0 to 1000 Hz, e.g. 15,30,100")
    return rates


def rate_of(part: Part, rates: Sequence[float]) -> float:
    """Return the rate of a part, in Hz: its own, or the common one.

    Raises
    ------
    ValueError
        If the number of rates is neither one nor the number of parts.
    """
    if len(rates) not in {1, part.count}:
        raise KnownError(f"{len(rates)} rates for {part.count} sources; give one, or one for each")
    return rates[part.index % len(rates)]
