"""``comotion source replay`` and ``simulator``: sources that play a recording or a simulated scene."""

from pathlib import Path
from typing import Literal

from ..errors import UserError
from ..network import Process
from ..options import Command, argument, option, setting

Stamps = Literal["now", "original"]
"""Stamps of recorded data: the time of publication, or those of the recording."""


class Timed(Command):
    """The option of a source that may end by itself."""

    duration: float | None = setting(None, "Stop after this time.", min=0, metavar="SECONDS")


class Played(Timed, Process):
    """Options of a source that plays a scene or a recording, as one source or several."""

    rate: str | None = setting(
        None,
        "Rate, or one rate per source for several sources. Default: that of the scene.",
        metavar="HZ[,HZ...]",
    )
    part: str | None = setting(
        None,
        "Publish only the K-th of N sources; each feature belongs to exactly one of them.",
        metavar="K/N",
    )
    loop: bool = setting(False, "Repeat; each pass is a new session.")
    start_at: str = setting(
        "now",
        "Start now, at a multiple of the length of the scene or recording, or at a Unix time. "
        "Sources in several processes need 'aligned' or a Unix time to be in phase.",
        metavar="now|aligned|SECONDS",
    )
    name: str | None = setting(
        None,
        "Name of the source; with several, NAME-1, NAME-2, ... Default: that of the command.",
        env="COMOTION_SOURCE_NAME",
    )


_NOT_FOR_MCAP = ("rate", "split", "part", "name", "fps")
_MCAP_ONLY = ("start", "end")


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

        schedule = self.call(Schedule, start_at=parse_start(self.start_at))
        if is_scene:
            replay.replay_scene(self.file, schedule, **self.where())
            return
        from comotion_sources.recordings import read_recording, recording_streams
        from comotion_sources.streams import parse_part, parse_rates

        part = parse_part(self.part)
        if part is not None and self.split not in {1, part.count}:
            raise UserError(f"--part {self.part} and --split {self.split} do not agree")
        rates = parse_rates(self.rate)
        recording = read_recording(self.file, self.fps)
        split = self.split if part is None else part.count
        streams = recording_streams(recording, split=split, rates=rates, source=self.name or "replay")
        if part is not None:
            streams = [streams[part.index]]
            streams[0].name = self.name or streams[0].name
        replay.replay_recording(recording, streams, schedule, **self.where())


class Simulator(Played):
    """Publish a simulated scene, with its truth, as one source or several."""

    epilog = """
Examples:
  comotion source simulator --list
  comotion source simulator fig4_4 --loop
  comotion source simulator fig4_4 --rate 15,30,100   # three sources in one process
  comotion source simulator fig4_4 --rate 30 --part 2/3 --start-at aligned --loop   # one of three processes
  comotion source simulator my_scene.toml --seed 7 --noise 2 --publish-sigma
"""

    simulated: str | None = argument(None, "SCENE", "A scene of --list, or a TOML file.")
    list_: bool = option(False, "List the scenes of the package and end.")
    split: Literal["features", "objects"] = setting("features", "How several sources divide the scene.")
    seed: int = setting(0, "Seed of the random numbers.", min=0)
    noise: float = setting(1.0, "Factor on the noise.", min=0)
    time_scale: float = setting(1.0, "2 plays twice as fast.")
    publish_sigma: bool = setting(False, "Publish the true noise.")

    def run(self) -> None:
        """Publish until stopped, or to the end of the scene."""
        from comotion_sources import simulator
        from comotion_sources.replay import play_streams
        from comotion_sources.schedule import Schedule, parse_start
        from comotion_sources.streams import parse_part, parse_rates

        if self.list_:
            for name in simulator.scene_names():
                spec = simulator.load_scene(name)
                rates = ", ".join(f"{rate:g}" for rate in spec.rates)
                print(f"{name:<12} {spec.dim}-D {spec.duration:>6g} s  {rates:>11} Hz  {spec.title}")
            return
        if self.simulated is None:
            raise UserError("which scene? see 'comotion source simulator --list'")
        simulations = simulator.simulate(
            simulator.load_scene(self.simulated),
            part=parse_part(self.part),
            rates=parse_rates(self.rate),
            seed=self.seed,
            noise=self.noise,
            time_scale=self.time_scale,
            split=self.split,
            name=self.name,
            publish_sigma=self.publish_sigma,
        )
        play_streams(
            simulations,
            self.call(Schedule, start_at=parse_start(self.start_at)),
            message=f"simulates {simulations[0].spec.title}",
            **self.where(),
        )
