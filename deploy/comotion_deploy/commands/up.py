"""``comotion up FILE.toml``: starts a system of processes."""

from dataclasses import dataclass, replace
from pathlib import Path

from ..config_file import load_toml
from ..options import Logged, argument, option, setting

DEFAULT_LOG = Path("comotion-up.log")


@dataclass(kw_only=True)
class Up(Logged):
    """Start router, sources, service and clients; restart failed processes; stop all on Ctrl-C."""

    epilog = """
Examples:
  comotion up deploy/scenes/fig4_4.toml
  comotion up workcell.toml --log workcell.log

The file is the --config of every process it starts; its tables process.NAME describe the processes:
  run = 'source simulator fig4.4 --rate 30'   (a comotion command)
  command = 'python my_tracker.py'   (any program)
  restart = 'on-failure'   (default; or 'always', 'never')
  tls = 'pki/cam'   (its certificate, see 'comotion pki')
  foreground = true   (owns the terminal; everything stops when it ends)
"""

    file: Path = argument(..., "FILE.toml", "Description of the system.")
    log: Path | None = setting(
        None,
        f"Write the processes' lines there. Default: standard output, or {DEFAULT_LOG} with a foreground "
        "process.",
        metavar="PATH",
    )
    duration: float | None = option(None, "Stop after this time.", min=0.1, metavar="SECONDS")

    def run(self) -> None:
        """Run the processes until they or the user end them."""
        from ..launcher import launch
        from ..processes import read_processes

        specs = read_processes(load_toml(self.file))
        specs = [replace(spec, env={"COMOTION_CONFIG": str(self.file), **spec.env}) for spec in specs]
        log = self.log
        if log is None and any(spec.foreground for spec in specs):
            log = DEFAULT_LOG
        launch(specs, log=log, duration_s=self.duration)
