"""Finds the recordings and simulated scenes that offline runs are to read."""

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.errors import KnownError
from comotion_schemas.recording import SUFFIX
from comotion_sources.recordings import read_recording, recording_streams
from comotion_sources.simulator import load_scene, simulate
from comotion_sources.streams import batches

SIMULATED = "sim:"
_SORT_SPAN_NS = 10_000_000_000
Message: TypeAlias = TruthBatch | ObservationBatch


@dataclass(frozen=True, slots=True)
class Arrived:
    """A batch with the time of the service clock at its receipt, for recordings."""

    batch: ObservationBatch
    now_ns: int


Incoming: TypeAlias = Message | Arrived
_Pending: TypeAlias = tuple[tuple[int, str, str, int, int], int, ObservationBatch]


@dataclass(frozen=True)
class Input:
    """One recording, or one seed of a scene.

    `name` is the name given by the user, `seed` None for a recording; `open` returns its messages.
    """

    name: str
    seed: int | None
    open: Callable[[], Iterable[Incoming]]


def parse_seeds(text: str) -> list[int]:
    """Parse seeds: numbers and ranges, separated by commas, e.g. ``0-4`` or ``0,2,7-9``.

    Raises
    ------
    ValueError
        If the text does not have this form.
    """
    seeds: list[int] = []
    for chunk in text.split(","):
        first, dash, last = chunk.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise KnownError(f"seeds {text!r} are not numbers and ranges such as 0-4 or 0,2,7-9")
        seeds += range(int(first), int(last if dash else first) + 1)
    if not 0 < len(seeds) <= 1000:
        raise KnownError(f"{len(seeds)} seeds are not 1 to 1000")
    return seeds


def find_inputs(
    names: Sequence[str],
    *,
    seeds: Sequence[int] = (0,),
    split: int = 1,
    rates: Sequence[float] | None = None,
    as_received: bool = False,
) -> list[Input]:
    """Find the inputs that the user named, and check all of them before the first run.

    Parameters
    ----------
    names
        Paths of recordings (.c3d, .npz, or .mcap of a whole scene), and simulated scenes: ``sim:``
        and the name of a scene in the package or the path of a TOML file.
    seeds
        Seeds of simulated scenes: one input per seed.
    split
        Divide the markers of recordings among this number of sources.
    rates
        Hz of every source, or of all; for a scene one per source.
    as_received
        Process recorded scenes in the order of receipt instead of the order of acquisition.

    Raises
    ------
    ValueError
        If a recording or scene is missing or unreadable, or the rates do not match.
    ImportError
        If an input is an .mcap file and the extra `record` is not installed.
    """
    inputs: list[Input] = []
    for name in names:
        if name.startswith(SIMULATED):
            spec = load_scene(name.removeprefix(SIMULATED))
            runs = [(seed, simulate(spec, seed=seed, rates=rates)) for seed in seeds]
            inputs += [Input(name, seed, partial(batches, run)) for seed, run in runs]
        else:
            inputs.append(_recorded(name, split, rates, as_received=as_received))
    return inputs


def _recorded(name: str, split: int, rates: Sequence[float] | None, *, as_received: bool) -> Input:
    if Path(name).suffix.lower() == SUFFIX:
        if split != 1 or rates is not None:
            raise KnownError(f"{name}: sources and rates of a recorded scene cannot be changed")
        from comotion_schemas.message_log import MessageLog

        MessageLog(Path(name)).close()
        return Input(name, None, lambda: _arrivals(name, as_received=as_received))
    # Read twice: once to check it before hours of work, and once for its run, so that only one
    # recording is in memory at a time.
    streams = partial(recording_streams, split=split, rates=rates)
    streams(read_recording(name))
    return Input(name, None, lambda: batches(streams(read_recording(name, doubted=False))))


def _arrivals(name: str, *, as_received: bool) -> Iterator[Incoming]:
    """Yield a recorded scene as a service with an event clock receives it."""
    from comotion.runtime.clocks import EventClock
    from comotion_schemas.message_log import MessageLog

    clock = EventClock()
    with MessageLog(Path(name)) as log:
        decoded = log.decoded({"obs", "truth"})
        logged = ((at, m) for at, m in decoded if isinstance(m, TruthBatch | ObservationBatch))
        for log_ns, message in logged if as_received else in_order_of_acquisition(logged):
            if isinstance(message, TruthBatch):
                yield message
            else:
                clock.observe(message.stamp_ns, log_ns)
                yield Arrived(message, clock.now_ns())


def in_order_of_acquisition(logged: Iterable[tuple[int, Message]]) -> Iterator[tuple[int, Message]]:
    """Sort batches by their stamps within a sliding span of 10 s.

    Two recordings of the same messages give the same order, whatever their delays were; truth comes
    first. A batch that arrived more than 10 s after newer data remains behind it. `logged` are
    (receipt in ns, message), in the order of receipt.
    """
    pending: list[_Pending] = []
    for number, (log_ns, message) in enumerate(logged):
        if isinstance(message, TruthBatch):
            yield log_ns, message
            continue
        place = (message.stamp_ns, message.source, message.session, message.seq, number)
        heapq.heappush(pending, (place, log_ns, message))
        while log_ns - pending[0][1] > _SORT_SPAN_NS:
            yield heapq.heappop(pending)[1:]
    yield from (left[1:] for left in sorted(pending))
