"""``comotion source replay``: publishes a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UserError
from ..options import argument, setting
from .source_options import Played, Stamps

if TYPE_CHECKING:
    from comotion_sources.recordings import Recording
    from comotion_sources.streams import Stream

_NOT_FOR_MCAP = ("rate", "split", "part", "name", "fps")
_MCAP_ONLY = ("start", "end")


@dataclass(kw_only=True)
class Replay(Played):
    """Publish a recording, with truth if it has labels, as one source or several.

    A recorded scene (.mcap) is published as its recorded sources, with
    --stamps original byte for byte. The space bar pauses any recording.
    """

    epilog = """
Examples:
  comotion source replay tennis_serve.c3d
  comotion source replay take.npz --loop --speed 2
  comotion source replay take.npz --split 3   # three sources, at 1, 1/2 and 1/3 of the rate
  comotion source replay take.npz --rate 50,25,10 --split 3
  comotion source replay take.npz --rate 30 --part 2/3 --start-at aligned --loop   # one of three processes
  comotion source replay take.npz --stamps original   # for: comotion serve --clock event
  comotion source replay apple.npz --fps 30   # tracks of CoTracker, TAPIR and the like
  comotion source replay scene.mcap --start 10 --end 40   # all sources of a recording of comotion record
"""

    file: Path = argument(..., "FILE", "A recording: .c3d, .npz, .npy or .csv; .mcap of a whole scene.")
    fps: float | None = setting(
        None, "Frames per second of tracks whose file has no times.", min=0.01, max=10_000
    )
    speed: float = setting(1.0, "Recorded seconds per second.")
    rate: str | None = setting(
        None,
        "Reduce to this rate by dropping frames, for all sources or for each. Default: that of the "
        "recording; 1/K of it for the K-th of several sources.",
        metavar="HZ[,HZ...]",
    )
    start: float = setting(0.0, "Start of the range (.mcap).", min=0, metavar="SECONDS")
    end: float | None = setting(None, "End of the range (.mcap).", min=0, metavar="SECONDS")
    split: int = setting(
        1,
        "Divide the markers among this number of sources, all in this process.",
        env="COMOTION_REPLAY_SPLIT",
        min=1,
        max=64,
    )
    stamps: Stamps = setting(
        "now",
        "Stamp with the wall clock, or with the time of the recording from 0 on "
        "(then serve with --clock event).",
    )

    def run(self) -> None:
        """Publish until stopped, or to the end of the recording."""
        is_scene = self.file.suffix.lower() == ".mcap"
        if is_scene:
            self.reject_flags(_NOT_FOR_MCAP, "is not for a recorded scene (.mcap)")
        else:
            self.reject_flags(_MCAP_ONLY, "is only for a recorded scene (.mcap)")
        from comotion_sources import replay
        from comotion_sources.schedule import Schedule, parse_start

        schedule = self.taken(Schedule, start_at=parse_start(self.start_at))
        if is_scene:
            replay.replay_scene(self.file, schedule, **self.where())
            return
        streams, recording = self._streams()
        replay.replay_recording(recording, streams, schedule, **self.where())

    def _streams(self) -> "tuple[list[Stream], Recording]":
        """The streams that this process publishes."""
        from dataclasses import replace

        from comotion_sources.recordings import read_recording, recording_streams

        part = self.chosen_part()
        if part is not None and self.split not in {1, part.count}:
            raise UserError(f"--part {self.part} and --split {self.split} do not agree")
        rates = self.rates()
        recording = read_recording(self.file, self.fps)
        split = self.split if part is None else part.count
        streams = recording_streams(recording, split=split, rates=rates, source=self.name or "replay")
        if part is not None:
            chosen = streams[part.index]
            streams = [chosen if self.name is None else replace(chosen, name=self.name)]
        return streams, recording
