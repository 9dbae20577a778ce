"""What a newcomer gives wrongly, and what is said: ``wrong_inputs.py`` tries all and prints a table.

The first half are errors, the second are converted or said as a warning. Nothing of this needs a checkout.
"""

import time
import warnings
from collections.abc import Callable

import numpy as np

import comotion
from comotion_sources.runtime import SourcePublisher

TIMES = np.arange(60) / 30
NS = (TIMES * 1e9).astype(np.int64)
IDS = np.arange(30)


def scene(unit=1.0):
    """Thirty features, ten of which slide, float64 [60, 30, 3] in m / unit."""
    positions = np.repeat(np.random.default_rng(0).uniform(-1, 1, (1, 30, 3)), 60, axis=0)
    positions[:, :10, 0] += 0.4 * TIMES[:, None]
    return positions * unit


P = scene()


def publisher(unit="m", dim=3):
    """A source that is not connected."""
    return SourcePublisher("mine", space="world", unit=unit, dim=dim, connect="tcp/127.0.0.1:1")


def online(factor):
    """Push all instants with times in another unit."""
    scene = comotion.Scene()
    for k, t in enumerate(TIMES.tolist()):
        scene.push(IDS, P[k], t * factor)


def rolled(every=10):
    """Ids that are places in a list, which moves on by one now and then."""
    return np.stack([np.roll(one, k // every, axis=0) for k, one in enumerate(P)])


WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "times in ms": (lambda: comotion.group(P, TIMES * 1e3), "look like milliseconds (30 Hz): divide by 1000"),
    "times unsorted": (lambda: comotion.group(P, TIMES[::-1]), "times do not increase"),
    "a time that was not set": (lambda: comotion.group(P, np.r_[0, 1.7e9 + TIMES[1:]]), "jump by"),
    "two clocks": (
        lambda: comotion.group({"a": P, "b": P}, {"a": TIMES, "b": 1.7e9 + TIMES}),
        "sources share one clock",
    ),
    "pushed in ms": (lambda: online(1e3), "look like milliseconds"),
    "no time": (lambda: comotion.Scene().push(IDS, P[0], None), "the time is None, not a number of seconds"),
    "unit of the scene": (
        lambda: comotion.Scene("mm"),
        "the unit is 'mm', not 'm' or 'px'; divide positions by 1000",
    ),
    "unit of a source": (lambda: publisher("mm"), "the unit is 'mm'"),
    "pixels in space": (
        lambda: comotion.group(P, TIMES, unit="px"),
        "positions in px have 2 coordinates, not 3",
    ),
    "keyword": (lambda: comotion.group(P, TIMES, windw=5), "'windw'; did you mean window?"),
    "dict": (
        lambda: comotion.group(P, TIMES, config={"window": -5}),
        "parameter window: Input should be greater",
    ),
    "shape": (lambda: comotion.group(P[0], TIMES), "positions have the shape (30, 3), not [T, N, 3]"),
    "too few times": (lambda: comotion.group(P, TIMES[:3]), "there are (3,) times for 60 instants"),
    "a position at infinity": (lambda: comotion.group(P + np.inf, TIMES), "a position is infinite"),
    "nothing seen": (lambda: comotion.group(P + np.nan, TIMES), "there is no observation"),
    "shape of a batch": (lambda: publisher().observe(ids=IDS, positions=P[0, :, :2]), "positions"),
    "shape of quaternions": (
        lambda: publisher().observe(ids=IDS, positions=P[0], quaternions=np.zeros((30, 3))),
        "quaternions: expected rows of 4, got 3",
    ),
    "infinite": (lambda: comotion.Scene().push(IDS, np.full((30, 3), np.inf), 0.0), "id 0 has a position"),
    "infinite, live": (lambda: publisher().observe(ids=IDS, positions=P[0] + np.inf), "id 0 has a position"),
    "a negative id": (lambda: comotion.Scene().push([-1], P[0, :1], 0.0), "id -1 is negative"),
    "too few ids": (lambda: comotion.Scene().push(IDS, P[0, :1], 0.0), "there are 30 ids for 1 positions"),
}
"""By name: a call that raises :class:`comotion.Error`, and words of its message."""

SAID: dict[str, tuple[Callable[[], object], str]] = {
    "int64 ns since a start": (lambda: comotion.group(P, NS), ""),
    "datetime64": (lambda: comotion.group(P, NS.astype("datetime64[ns]")), ""),
    "a row of NaN": (lambda: comotion.group(np.where(IDS[:, None] == 3, np.nan, P), TIMES), ""),
    "positions in mm": (
        lambda: comotion.group(scene(1000.0), TIMES),
        "if they are millimetres, divide them by 1000",
    ),
    "ids that move on in a list": (
        lambda: comotion.group(rolled(), TIMES),
        "at 5 of 59 steps, first after instant 9, features jump to",
    ),
    "shares of the image": (
        lambda: comotion.group(scene()[..., :2] / 100, TIMES),
        "if they are shares of the image, multiply them by its size",
    ),
    "far from the origin": (
        lambda: comotion.group(P + np.array([5e5, 4.2e6, 0]), TIMES),
        "positions are 4.2e+06 from the origin, where the single precision",
    ),
}
"""By name: a call that is carried out, and words of its warning; none where the input is converted."""


def outcome(call):
    """Seconds that a call takes, and what it says: its error, else its warnings, else its result."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        begun = time.perf_counter()
        try:
            said = repr(call())
        except comotion.Error as error:
            said = f"comotion.Error: {error}"
        took = time.perf_counter() - begun
    return took, " ".join([*(f"warning: {one.message}" for one in caught), said])


if __name__ == "__main__":
    comotion.group(P, TIMES)  # compiles, once
    comotion.group(P[..., :2], TIMES)
    print("| given | s | said |\n|---|---:|---|")
    for name, (call, _) in (WRONG | SAID).items():
        took, said = outcome(call)
        print(f"| {name} | {took:.2f} | {said[:250]} |", flush=True)
