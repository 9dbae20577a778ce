"""``comotion joints``: how the bodies of a scene are connected, as a table, JSON or URDF."""

from pathlib import Path

from ..errors import UserError
from ..network import Client
from ..options import Fusion, Json, argument, setting
from .look import BodyNames

_OFFLINE_ONLY = ("method", "set_", "duration")
_LIVE_ONLY = ("scene", "connect", "tls", "timeout")


class Joints(Fusion, BodyNames, Json, Client):
    """Say how the bodies of a scene are connected, as of the last update: hinges, slides, fixed ones.

    The URDF has a link for each hypothesis with a pose, as a box of its extent, and its joints with
    the ranges seen. Position 0 is that of the update; what has no joint floats. Masses are made up.
    """

    epilog = """
Examples:
  comotion joints   # of a running scene
  comotion joints --name 1=cabinet --name 2=door   # "door turns on cabinet, 0 to 65°"
  comotion joints take.mcap --urdf cabinet.urdf
  comotion joints sim:fig4_4 --duration 6 --json
"""
    log_level = "warning"

    file: str | None = argument(
        None,
        "FILE",
        "A recording (.c3d, .npz, .mcap) or a simulated scene (sim:NAME). Without: the running scene.",
    )
    urdf: Path | None = setting(None, "Write a URDF file.", metavar="FILE")
    space: str | None = setting(None, "Space of the URDF, where there are several.")
    duration: float | None = setting(
        None, "How much of the file. Default: to the end.", min=0.1, metavar="SECONDS"
    )
    timeout: float = setting(5.0, "Longest wait for an update.", min=0.1, metavar="SECONDS")

    def run(self) -> None:
        """Print the joints, and write the URDF if that is wanted."""
        if self.urdf is not None and not self.urdf.parent.is_dir():
            raise UserError(f"{self.urdf.parent}: no such folder")
        if self.file is None:
            self.reject_flags(_OFFLINE_ONLY, "is only for a FILE")
            from comotion_clients.subscribe import subscribe

            settings = self.settings()
            with subscribe(self.scene, settings.connect, timeout=self.timeout, tls=settings.tls) as updates:
                try:
                    update = next(updates)
                except TimeoutError:
                    raise UserError(f"no update of scene {self.scene} within {self.timeout:g} s") from None
        else:
            self.reject_flags(_LIVE_ONLY, "is only for a running scene, without FILE")
            from comotion_experiments.inputs import find_inputs

            config = self.fusion_config()
            (recording,) = find_inputs([self.file])
            from comotion_experiments.offline import run_offline

            update = run_offline(recording.open(), config, duration=self.duration).last
        from comotion_clients.bodies import as_json
        from comotion_clients.watch_columns import joint_table

        self.show(as_json(update), joint_table(update.joints, self.names()), width=120)
        if self.urdf is not None:
            from comotion_clients.formats import to_urdf

            self.urdf.write_text(to_urdf(update, self.space), encoding="utf-8")
            if not self.json_:
                print(f"urdf: {self.urdf}")
