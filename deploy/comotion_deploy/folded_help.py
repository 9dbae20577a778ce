"""Short help: options that all commands share, and environment variables, are shown by ``--help-all``."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import typer

COMMON = frozenset(
    {"connect", "listen", "tls", "insecure", "_config", "_log_level", "_metrics", "ready_file"}
)
"""Parameters of the shared options; :mod:`.options` has them."""
ALL = "--help-all"
_HINT = "Shared options (--connect, --config, --log-level ...) and environment variables: --help-all"


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
        folded |= parameter.name in COMMON
        if parameter.name in COMMON:
            parameter.hidden = True
        if hasattr(parameter, "show_envvar"):
            folded |= bool(parameter.show_envvar and parameter.envvar)
            parameter.show_envvar = False
    if folded:
        command.epilog = f"{command.epilog or ''}\n\n{_HINT}\n"
