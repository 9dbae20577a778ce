"""Recording -> streams: the markers divided among sources of different rates."""

from collections.abc import Iterator, Sequence

from comotion_schemas import ObservationBatch, TruthBatch

from ..parts import Part, rate_of
from ..streams import Stream, merged, numbered
from .recording import RecordedFrames, Recording, decimate, split_markers

DEFAULT_NAME = "replay"


def recording_streams(
    recording: Recording,
    *,
    split: int = 1,
    rates: Sequence[float] | None = None,
    source: str = DEFAULT_NAME,
) -> list[Stream]:
    """Divide the markers of a recording among sources.

    Parameters
    ----------
    recording
        The recording.
    split
        Number of sources; each gets every `split`-th marker.
    rates
        Hz, one for all sources or one for each, obtained by dropping frames. None: the k-th source
        has 1/k of the rate of the recording.
    source
        Name of the source; with several sources, the k-th is ``<source>-k``.

    Raises
    ------
    RecordingError
        If a rate is above that of the recording.
    ValueError
        If the number of rates is neither one nor the number of sources.
    """
    rate_of_part: Sequence[float | None]
    if rates is None:
        rate_of_part = [None, *(recording.rate / k for k in range(2, split + 1))]
    else:
        rate_of_part = [rate_of(Part(part, split), rates) for part in range(split)]
    return [
        Stream(
            name=numbered(source, part, split),
            space=recording.space,
            unit=recording.unit,
            dim=recording.dim,
            objects=recording.label_names,
            rate=rate_of_part[part] or recording.rate,
            length=recording.length,
            frames=RecordedFrames(
                recording, markers=markers, instants=decimate(recording.times, rate_of_part[part])
            ),
        )
        for part, markers in enumerate(split_markers(recording.positions.shape[1], split))
    ]


def recording_batches(
    recording: Recording,
    *,
    split: int = 1,
    rates: Sequence[float] | None = None,
    source: str = DEFAULT_NAME,
    epoch_ns: int = 0,
) -> Iterator[TruthBatch | ObservationBatch]:
    """Yield the messages that a replay of the recording publishes, in time order.

    Parameters
    ----------
    recording, split, rates, source
        As in :func:`recording_streams`, as are the errors.
    epoch_ns
        Stamp of the first instant.
    """
    streams = recording_streams(recording, split=split, rates=rates, source=source)
    return merged(streams, epoch_ns=epoch_ns, publish_sigma=True)
