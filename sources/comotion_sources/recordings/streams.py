"""Recordings as streams: markers divided among sources of different rates."""

from collections.abc import Iterator, Sequence

from comotion_schemas import ObservationBatch, TruthBatch

from ..parts import Part, rate_of
from ..streams import OFFLINE_SESSION, Stream, merged, numbered
from .recording import RecordedFrames, Recording, divide, thin

DEFAULT_NAME = "replay"


def recording_streams(
    recording: Recording,
    *,
    split: int = 1,
    rates: Sequence[float] | None = None,
    source: str = DEFAULT_NAME,
    time_scale: float = 1.0,
) -> list[Stream]:
    """Divide a recording among sources.

    Parameters
    ----------
    recording
        What to publish.
    split
        Number of sources; markers are dealt out to them in turn.
    rates
        Hz, one for all sources or one for each, brought about by dropping frames. By default the
        k-th source has 1/k of the recording's rate.
    source
        Name of the source; of several, the k-th is ``<source>-k``.
    time_scale
        Factor on the times.

    Raises
    ------
    RecordingError
        If a rate is above that of the recording.
    ValueError
        If there are neither as many rates as sources nor a single one.
    """
    wanted: Sequence[float | None]
    if rates is None:
        wanted = [None, *(recording.rate / k for k in range(2, split + 1))]
    else:
        wanted = [rate_of(Part(part, split), rates) for part in range(split)]
    return [
        Stream(
            name=numbered(source, part, split),
            space=recording.space,
            unit=recording.unit,
            dim=recording.dim,
            objects=recording.label_names,
            rate=(wanted[part] or recording.rate) / time_scale,
            length=recording.length * time_scale,
            frames=RecordedFrames(
                recording,
                markers=markers,
                instants=thin(recording.times, wanted[part]),
                time_scale=time_scale,
            ),
        )
        for part, markers in enumerate(divide(recording.positions.shape[1], split))
    ]


def recording_batches(
    recording: Recording,
    *,
    split: int = 1,
    rates: Sequence[float] | None = None,
    source: str = DEFAULT_NAME,
    session: str = OFFLINE_SESSION,
    epoch_ns: int = 0,
) -> Iterator[TruthBatch | ObservationBatch]:
    """Yield what the replay of a recording publishes, in time order, stamped from `epoch_ns` on.

    Parameters and errors are those of :func:`recording_streams`; `session` is that of every source.
    """
    streams = recording_streams(recording, split=split, rates=rates, source=source)
    return merged(streams, session=session, epoch_ns=epoch_ns)
