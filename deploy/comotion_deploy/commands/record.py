"""``comotion record``: records a scene to MCAP files, repairs them and exports them."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

from ..errors import UserError, require_suffix
from ..network import Process
from ..options import Json, argument, option, setting


class Record(Json, Process):
    """Record all messages of a scene to MCAP, byte for byte.

    Data is written to the disk every second: a crash loses at most one second.
    """

    epilog = """
Examples:
  comotion record
  comotion record take.mcap --scene workcell --duration 60
  comotion record take.mcap --max-size 500 --max-time 600   # take-001.mcap, take-002.mcap, ...
  comotion record --repair take.mcap   # after a crash
  comotion record --export take.mcap --out take-foxglove.mcap   # for Foxglove

To play a recording: comotion source replay take.mcap
"""

    file: Path | None = argument(None, "FILE.mcap", "File to write. Default: SCENE-DATE-TIME.mcap.")
    duration: float | None = setting(None, "Stop after this time.", min=0.1, metavar="SECONDS")
    max_size: float | None = setting(None, "Size after which a new file begins.", min=0.001, metavar="MIB")
    max_time: float | None = setting(None, "Time after which a new file begins.", min=0.1, metavar="SECONDS")
    reserve: float = setting(64.0, "Space that remains free on the disk.", min=0, metavar="MIB")
    repair: Path | None = option(
        None, "Copy all readable messages of a damaged file to a new file, and end.", metavar="FILE"
    )
    export: Path | None = option(None, "Convert a recording for Foxglove, and end.", metavar="FILE")
    out: Path | None = option(None, "Result of --repair or --export.", metavar="OUT.mcap")
    name: str = setting(
        "recorder", "Name of this recorder. With a certificate: its name.", env="COMOTION_RECORDER_NAME"
    )

    def run(self) -> None:
        """Record until stopped; or repair or export a file."""
        import mcap  # noqa: F401 - before anything is checked or connected

        if (source := self.repair or self.export) is not None:
            if self.file is not None or (self.repair is not None and self.export is not None):
                raise UserError("--repair and --export take one file each and do not record")
            convert: Callable[[Path, Path], Any]
            if self.repair is not None:
                from comotion_clients.recording.repair import repair as convert
            else:
                from comotion_clients.foxglove.scene import export as convert
            ending = "foxglove" if self.repair is None else "repaired"
            target = self.out or source.with_name(f"{source.stem}-{ending}.mcap")
            converted = convert(source, target)
            self.show(converted, *converted.lines(target))
            return
        if self.out is not None:
            raise UserError("--out needs --repair or --export")
        from comotion_clients.recording.process import record
        from comotion_clients.recording.series import SeriesOptions
        from comotion_schemas import Keys

        scene = Keys(self.scene).scene
        path = self.file or Path(f"{scene}-{datetime.now().astimezone():%Y%m%d-%H%M%S}.mcap")
        require_suffix(path, "a recording", ".mcap")
        series = SeriesOptions(
            path=path,
            scene=scene,
            max_bytes=None if self.max_size is None else round(self.max_size * 2**20),
            max_seconds=self.max_time,
            reserve_bytes=round(self.reserve * 2**20),
        )
        result = record(series, self.name, self.duration, **self.where())
        self.show(result, *result.lines())
