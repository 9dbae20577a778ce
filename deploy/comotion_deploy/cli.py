"""The command ``comotion``: registers its commands, shows their help and reports their errors.

The help is short: shared and rare options, and environment variables, are shown by ``--help-all`` alone.
"""

import logging
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import typer

from .commands import dev, fleet, pki
from .commands.calibrate import Calibrate
from .commands.camera_sources import ExternalCamera, Klt
from .commands.dev import in_checkout
from .commands.evaluate import Evaluate, Joints
from .commands.look import Status, View, Watch
from .commands.played_sources import Replay, Simulator
from .commands.record import Record
from .commands.robot_sources import Proprioception, Workcell
from .commands.ros2 import Ros2, SourceRos2
from .commands.segment import Segment
from .commands.serve import Config, Serve
from .commands.up import Demo, Router, Up
from .errors import UserError, missing_extra, one_line
from .options import Command, add, flowing

_EPILOG = """
Begin with:
  comotion demo   # a simulated scene with three sources, for half a minute
  comotion segment VIDEO.mp4   # a video of your own, its features grouped

Options and examples of a command: comotion COMMAND --help
"""
app = typer.Typer(
    name="comotion",
    help="Group tracked features from several live sources into objects by how they move.",
    epilog=flowing(_EPILOG),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        print(f"comotion {metadata.version('comotion')}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version."
    ),
) -> None:
    pass


_sources = typer.Typer(help="Publish tracked features to a scene.", no_args_is_help=True)
add(_sources, {"simulator": Simulator, "replay": Replay, "ros2": SourceRos2, "workcell": Workcell})
add(_sources, {"proprioception": Proprioception, "klt": Klt, "external-camera": ExternalCamera})
_PANELS: dict[str, dict[str, type[Command] | typer.Typer]] = {
    "Start": {"demo": Demo, "up": Up},
    "Run": {"router": Router, "serve": Serve, "source": _sources, "ros2": Ros2},
    "Look": {"watch": Watch, "view": View, "status": Status},
    "Data": {
        "segment": Segment,
        "record": Record,
        "evaluate": Evaluate,
        "joints": Joints,
        "calibrate": Calibrate,
    },
    "Operate": {"config": Config, "pki": pki.app, "fleet": fleet.app},
    "Develop": {"dev": dev.app},
}
for _panel, _commands in _PANELS.items():
    add(app, _commands, _panel)


def _present(arguments: Sequence[str]) -> list[str]:
    """Arguments with the present names of commands; says where one has moved, and what no wheel has."""
    words = list(arguments)
    if words and words[0] in dev.MOVED:
        print(f"'comotion {words[0]}' is now 'comotion dev {words[0]}'", file=sys.stderr)
        words.insert(0, "dev")
    if words[:1] == ["dev"] and dev.OF_CHECKOUT & set(words[1:3]) and not in_checkout():
        raise UserError("this needs a checkout of the repository: make setup, in a clone")
    return words


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit status: 0, 2 for a known error, 130 if interrupted.

    Any other error is a defect; its traceback is shown.
    """
    try:
        result = helped(app, _present(arguments))(prog_name="comotion", standalone_mode=False)
    except typer.TyperException as error:
        return _fail(error.format_message(), error)
    except (UserError, OSError) as error:
        return _fail(error, error)
    except ImportError as error:
        if (missing := missing_extra(error)) is None:
            raise
        return _fail(missing, error)
    except ValueError as error:
        if not _is_of_user(error):
            raise
        return _fail(error, error)
    except (typer.Abort, KeyboardInterrupt):
        return 130
    return result if isinstance(result, int) else 0


def _is_of_user(error: ValueError) -> bool:
    """Whether something given is wrong, as we or those who parse it for us say; any other is a defect."""
    # Importing these takes longer than to show the help.
    import json
    import tomllib

    from comotion_schemas.errors import KnownError

    validated = type(error).__module__.startswith("pydantic")
    expected = KnownError, UnicodeError, json.JSONDecodeError, tomllib.TOMLDecodeError
    return validated or isinstance(error, expected)


def _fail(message: object, error: Exception) -> int:
    if isinstance(error, FileExistsError) and error.filename is not None:
        message = f"{error.filename} exists, and is not replaced: remove it, or give another name"
    elif isinstance(error, OSError) and error.filename is not None:
        message = f"{error.filename}: {error.strerror}"  # without the number of the error
    logging.getLogger(__name__).debug("where it happened", exc_info=error)
    if text := one_line(message).replace(": Value error, ", ": "):  # empty if the help was printed
        print(f"error: {text}", file=sys.stderr)
    return 2


def _warn(message: Warning | str, *_: object) -> None:
    """Show a warning as one line, without the place in the code."""
    print(f"warning: {one_line(message)}", file=sys.stderr)


def main() -> None:
    """Entry point of the command."""
    warnings.showwarning = _warn  # type: ignore[assignment]
    sys.exit(run(sys.argv[1:]))


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
    for each in _whole(command):
        _make_plain(each)
        if ALL not in arguments:
            _fold(each)
    return partial(command, ["--help" if word == ALL else word for word in arguments])


def _whole(group: Any) -> Iterator[Any]:
    """Yield a group and all below it."""
    yield group
    for child in getattr(group, "commands", {}).values():
        yield from _whole(child)


def _make_plain(command: Any) -> None:
    """Leave out the types of flags and arguments, which their words say better."""
    for parameter in command.get_params(typer.Context(command)):
        if getattr(parameter, "is_flag", False):
            parameter.metavar = " "
        elif parameter.param_type_name == "argument":
            parameter.display_type_rich = lambda ctx: None  # noqa: ARG005


def _fold(command: Any) -> None:
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
