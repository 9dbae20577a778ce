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
    if arguments and not {"--help", ALL} & set(arguments):
        return partial(app, list(arguments))
    command: Any = typer.main.get_command(app)
    _make_plain(command)
    if ALL not in arguments:
        _fold(command)
    return partial(command, ["--help" if word == ALL else word for word in arguments])


def _make_plain(command: Any) -> None:
    """Leave out the types of flags and arguments, which their words say better."""
    for child in getattr(command, "commands", {}).values():
        _make_plain(child)
    for parameter in command.get_params(typer.Context(command)):
        if getattr(parameter, "is_flag", False):
            parameter.metavar = " "
        elif parameter.param_type_name == "argument":
            parameter.display_type_rich = lambda ctx: None  # noqa: ARG005


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
    if switched_on:
        option.show_default = "on"
    option.opts = [*option.opts[:1], *(option.secondary_opts[:1] if switched_on else ())]
    option.secondary_opts = []
