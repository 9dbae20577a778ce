"""What can be evaluated offline: recordings by path, simulated scenes as ``sim:NAME``."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from comotion_sources import simulator
from comotion_sources.recordings import read_recording, recording_batches

from .offline import Message

SIMULATED = "sim:"


@dataclass(frozen=True)
class Input:
    """One recording, or one seed of a scene.

    `name` is what the user called it, `seed` None for a recording; `open` yields its messages anew.
    """

    name: str
    seed: int | None
    open: Callable[[], Iterable[Message]]


def parse_seeds(text: str) -> list[int]:
    """Read seeds: numbers and ranges, separated by commas, e.g. ``0-4`` or ``0,2,7-9``.

    Raises
    ------
    ValueError
        If it is not that.
    """
    seeds: list[int] = []
    for chunk in text.split(","):
        first, dash, last = chunk.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ValueError(f"seeds {text!r} are not numbers and ranges such as 0-4 or 0,2,7-9")
        seeds += range(int(first), int(last if dash else first) + 1)
    if not 0 < len(seeds) <= 1000:
        raise ValueError(f"{len(seeds)} seeds are not 1 to 1000")
    return seeds


def find_inputs(
    names: Sequence[str],
    *,
    seeds: Sequence[int] = (0,),
    split: int = 1,
    rates: Sequence[float] | None = None,
) -> list[Input]:
    """Resolve what the user named; everything is checked before anything runs.

    Parameters
    ----------
    names
        Paths of recordings (.c3d, .npz), and simulated scenes: ``sim:`` and the name of one that
        ships or the path of a TOML file.
    seeds
        Of simulated scenes: one input per seed.
    split
        Divide the markers of recordings among so many sources.
    rates
        Hz of every source, or of all; of a scene as many as it is to have sources.

    Raises
    ------
    ValueError
        If a recording or scene is missing or unreadable, or the rates do not suit it.
    """
    found: list[Input] = []
    for name in names:
        if name.startswith(SIMULATED):
            found += _simulated(name, seeds, rates)
        else:
            found.append(_recorded(name, split, rates))
    return found


def _simulated(name: str, seeds: Sequence[int], rates: Sequence[float] | None) -> list[Input]:
    spec = simulator.load_scene(name.removeprefix(SIMULATED))
    runs = [(seed, simulator.simulate(spec, seed=seed, rates=rates)) for seed in seeds]
    return [Input(name, seed, lambda run=run: simulator.batches(run)) for seed, run in runs]  # type: ignore[misc]


def _recorded(name: str, split: int, rates: Sequence[float] | None) -> Input:
    # Read twice: once to refuse what is unreadable before hours of work, once when its turn comes,
    # so that only one recording is in memory at a time.
    recording_batches(read_recording(name), split=split, rates=rates)
    return Input(name, None, lambda: recording_batches(read_recording(name), split=split, rates=rates))
