"""``comotion watch``: a live table of one scene."""

from dataclasses import dataclass
from typing import Literal

from ..options import Command, Json, Present, setting


@dataclass(kw_only=True)
class BodyNames(Command):
    """The option of a command that shows hypotheses."""

    name: list[str] | None = setting(
        None,
        "Name of a hypothesis, such as 2=truck; may be repeated.",
        env="COMOTION_NAMES",
        metavar="ID=NAME",
    )

    def names(self) -> dict[int, str]:
        """Return the name of each hypothesis that has one."""
        from comotion_schemas.naming import read_names

        return read_names(self.name or ())


@dataclass(kw_only=True)
class Watch(BodyNames, Json, Present):
    """Show the current sources, hypotheses, tracks and events of a scene.

    Plain lines if the output is not a terminal; with --json one object per line.
    """

    epilog = """
Examples:
  comotion watch
  comotion watch --scene workcell --sort age
  comotion watch --once --json | jq .service.state
  comotion watch --once --pose
  comotion watch --name 2=truck --name 3=gripper
  comotion watch > scene.log   # one line a second
"""
    log_level = "warning"

    once: bool = setting(False, "Show it once and end.")
    sort: Literal["size", "name", "age"] = setting(
        "size", "By size, by name or id, or by age; the key s changes it."
    )
    pose: bool = setting(False, "Angular speed and pose; the key p changes it.")
    timeout: float = setting(5.0, "How long --once waits for the scene.", min=0.1, metavar="SECONDS")
    all_events: bool = setting(False, "Events of joints too, not of bodies alone.")

    def run(self) -> None:
        """Show it until stopped."""
        from comotion_clients.watch import WatchOptions, watch

        watch(self.taken(WatchOptions, json=self.json_, names=self.names()), **self.where())
