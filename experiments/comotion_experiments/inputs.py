"""What can be evaluated offline: recordings by path, simulated scenes as ``sim:NAME``."""

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from comotion.runtime.clocks import EventClock
from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.recording import SUFFIX
from comotion_sources import simulator
from comotion_sources.recordings import read_recording, recording_batches

from .offline import Arrived, Incoming, Message

SIMULATED = "sim:"
_LATEST_NS = 10_000_000_000
_Waiting: TypeAlias = tuple[tuple[int, str, str, int, int], int, ObservationBatch]


@dataclass(frozen=True)
class Input:
    """One recording, or one seed of a scene.

    `name` is what the user called it, `seed` None for a recording; `open` yields its messages anew.
    """

    name: str
    seed: int | None
    open: Callable[[], Iterable[Incoming]]


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
    as_received: bool = False,
) -> list[Input]:
    """Resolve what the user named; everything is checked before anything runs.

    Parameters
    ----------
    names
        Paths of recordings (.c3d, .npz, or .mcap of a whole scene), and simulated scenes: ``sim:``
        and the name of one that ships or the path of a TOML file.
    seeds
        Of simulated scenes: one input per seed.
    split
        Divide the markers of recordings among so many sources.
    rates
        Hz of every source, or of all; of a scene as many as it is to have sources.
    as_received
        Feed recorded scenes in the order of receipt instead of that of acquisition.

    Raises
    ------
    ValueError
        If a recording or scene is missing or unreadable, or the rates do not suit it.
    ImportError
        If the extra `record` is missing and there is an .mcap.
    """
    found: list[Input] = []
    for name in names:
        if name.startswith(SIMULATED):
            found += _simulated(name, seeds, rates)
        else:
            found.append(_recorded(name, split, rates, as_received=as_received))
    return found


def _simulated(name: str, seeds: Sequence[int], rates: Sequence[float] | None) -> list[Input]:
    spec = simulator.load_scene(name.removeprefix(SIMULATED))
    runs = [(seed, simulator.simulate(spec, seed=seed, rates=rates)) for seed in seeds]
    return [Input(name, seed, lambda run=run: simulator.batches(run)) for seed, run in runs]  # type: ignore[misc]


def _recorded(name: str, split: int, rates: Sequence[float] | None, *, as_received: bool) -> Input:
    if Path(name).suffix.lower() == SUFFIX:
        if split != 1 or rates is not None:
            raise ValueError(f"{name}: a recorded scene has the sources and rates it has")
        return _recorded_scene(name, as_received=as_received)
    # Read twice: once to refuse what is unreadable before hours of work, once when its turn comes,
    # so that only one recording is in memory at a time.
    recording_batches(read_recording(name), split=split, rates=rates)
    return Input(name, None, lambda: recording_batches(read_recording(name), split=split, rates=rates))


def _recorded_scene(name: str, *, as_received: bool) -> Input:
    from comotion_sources.recordings.messages import MessageLog

    MessageLog(Path(name)).close()
    return Input(name, None, lambda: _arrivals(name, as_received=as_received))


def _arrivals(name: str, *, as_received: bool) -> Iterator[Incoming]:
    """A recorded scene as a service with an event clock takes it in."""
    from comotion_sources.recordings.messages import logged_batches

    clock, logged = EventClock(), logged_batches(name)
    for log_ns, message in logged if as_received else in_order_of_acquisition(logged):
        if isinstance(message, TruthBatch):
            yield message
            continue
        clock.observe(message.stamp_ns, log_ns)
        yield Arrived(message, clock.now_ns())


def in_order_of_acquisition(logged: Iterable[tuple[int, Message]]) -> Iterator[tuple[int, Message]]:
    """Sort batches by their stamps, with as much memory as 10 s of a recording take.

    Two recordings of the same messages give the same order, however these were held up on their
    way; truth comes first. What came more than 10 s after later data stays behind it.

    Parameters
    ----------
    logged
        (receipt in ns, message), in the order of receipt.
    """
    waiting: list[_Waiting] = []
    for number, (log_ns, message) in enumerate(logged):
        if isinstance(message, TruthBatch):
            yield log_ns, message
            continue
        place = (message.stamp_ns, message.source, message.session, message.seq, number)
        heapq.heappush(waiting, (place, log_ns, message))
        while log_ns - waiting[0][1] > _LATEST_NS:
            yield _popped(waiting)
    while waiting:
        yield _popped(waiting)


def _popped(waiting: list[_Waiting]) -> tuple[int, ObservationBatch]:
    _, log_ns, batch = heapq.heappop(waiting)
    return log_ns, batch
