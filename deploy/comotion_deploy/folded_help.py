"""Short help: shared and rare options, and environment variables, are shown by ``--help-all`` alone."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import typer

COMMON = frozenset(
    {"connect", "listen", "tls", "insecure", "config", "log_level", "metrics_port", "ready_file"}
)
"""Parameters of the shared options; :mod:`.options` has them."""
RARE = frozenset({"respawn_every", "tracker", "realtime", "reconnect", "share_preview", "clock_offset"})
"""Parameters of cameras that few people set."""
ALL = "--help-all"
_HINT = "More options (--connect, --config, --log-level ...) and environment variables: --help-all"


def helped(app: typer.Typer, arguments: Sequence[str]) -> Callable[..., Any]:
    """Return a call of the app with its help folded, or with ``--help-all``, whole."""
    given = list(arguments)
    if ALL in given:
        return partial(app, ["--help" if word == ALL else word for word in given])
    if "--help" not in given:
        return partial(app, given)
    command = typer.main.get_command(app)
    _fold(command)
    return partial(command, given)


def _fold(command: Any) -> None:
    for child in getattr(command, "commands", {}).values():
        _fold(child)
    folded = False
    for parameter in command.params:
        if parameter.name in COMMON | RARE:
            folded = parameter.hidden = True
        if hasattr(parameter, "show_envvar"):
            folded |= bool(parameter.show_envvar and parameter.envvar)
            parameter.show_envvar = False
            _shorten(parameter)
    if folded:
        command.epilog = f"{command.epilog or ''}\n\n{_HINT}\n"


def _shorten(option: Any) -> None:
    """Show few names of an option in one column, so that the words fit beside them.

    A flag that is on shows how to switch it off; any other option shows its first name.
    """
    switched_on = getattr(option, "is_flag", False) and option.default is True
    if getattr(option, "is_flag", False):
        option.metavar = " "
    option.opts = [*option.opts[:1], *(option.secondary_opts[:1] if switched_on else ())]
    option.secondary_opts = []
