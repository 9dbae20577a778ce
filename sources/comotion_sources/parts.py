"""How one scene or recording is divided among several sources: what the options say."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """Which of several sources one is: number `index` (from 0) of `count`."""

    index: int
    count: int


def parse_part(text: str) -> Part:
    """Read ``k/n``: the k-th of n sources, counted from 1.

    Raises
    ------
    ValueError
        If it is not that.
    """
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second) <= 64:
        return Part(int(first) - 1, int(second))
    raise ValueError(f"part {text!r} is not K/N with 1 <= K <= N <= 64, e.g. 2/3")


def parse_rates(text: str) -> list[float]:
    """Read rates in Hz, separated by commas.

    Raises
    ------
    ValueError
        If one is no number above 0.
    """
    try:
        rates = [float(chunk) for chunk in text.split(",")]
    except ValueError:
        rates = []
    if not rates or not all(0 < rate <= 1000 for rate in rates):
        raise ValueError(f"rate {text!r} is not one or several numbers from 0 to 1000 Hz, e.g. 15,30,100")
    return rates


def rate_of(part: Part, rates: Sequence[float]) -> float:
    """Pick the rate of a part: its own where each has one, else the one that all share.

    Raises
    ------
    ValueError
        If there are neither as many rates as parts nor a single one.
    """
    if len(rates) not in {1, part.count}:
        raise ValueError(f"{len(rates)} rates for {part.count} sources; give one, or one for each")
    return rates[part.index % len(rates)]
