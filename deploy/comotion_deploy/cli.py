"""The command ``comotion``: registers its commands and reports their errors."""

import json
import logging
import sys
import tomllib
import warnings
from collections.abc import Sequence
from importlib import metadata
from typing import Any

import typer

from .commands import (
    calibrate,
    config,
    demo,
    dev,
    evaluate,
    fleet,
    joints,
    pki,
    record,
    ros2,
    router,
    segment,
    serve,
    source,
    status,
    up,
    view,
    watch,
)
from .errors import UserError, one_line
from .folded_help import helped

app = typer.Typer(
    name="comotion",
    help="Group tracked features from several live sources into objects by how they move.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"comotion {metadata.version('comotion')}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version."
    ),
) -> None:
    pass


_PANELS: dict[str, dict[str, Any]] = {
    "Start": {"demo": demo, "up": up},
    "Run": {"router": router, "serve": serve, "source": source, "ros2": ros2},
    "Look": {"watch": watch, "view": view, "status": status},
    "Data": {
        "segment": segment,
        "record": record,
        "evaluate": evaluate,
        "joints": joints,
        "calibrate": calibrate,
    },
    "Operate": {"config": config, "pki": pki, "fleet": fleet},
    "Develop": {"dev": dev},
}
for _panel, _commands in _PANELS.items():
    for _name, _module in _commands.items():
        if hasattr(_module, "app"):
            app.add_typer(_module.app, name=_name, rich_help_panel=_panel)
        else:
            app.command(_name, epilog=_module.EPILOG, rich_help_panel=_panel)(getattr(_module, _name))


def _present(arguments: Sequence[str]) -> list[str]:
    """Arguments with the present names of commands; says where one has moved."""
    if arguments and arguments[0] in dev.MOVED:
        print(f"'comotion {arguments[0]}' is now 'comotion dev {arguments[0]}'", file=sys.stderr)
        return ["dev", *arguments]
    return list(arguments)


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
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("comotion_experiments."):
            raise
        return _fail("this needs a checkout of the repository: the wheel has what users run", error)
    except ValueError as error:
        if not _is_known(error):
            raise
        return _fail(error, error)
    except (typer.Abort, KeyboardInterrupt):
        return 130
    return result if isinstance(result, int) else 0


def _is_known(error: ValueError) -> bool:
    """Whether something given is wrong, as we or those who parse it for us say; any other is a defect."""
    # Importing these takes longer than to show the help.
    from comotion_schemas.errors import KnownError

    validated = type(error).__module__.startswith("pydantic")
    known = KnownError, UnicodeError, json.JSONDecodeError, tomllib.TOMLDecodeError
    return validated or isinstance(error, known)


def _fail(message: object, error: Exception) -> int:
    logging.getLogger(__name__).debug("where it happened", exc_info=error)
    if text := one_line(message):  # empty if the help was printed
        print(f"error: {text}", file=sys.stderr)
    return 2


def _warn(message: Warning | str, *_: object) -> None:
    """Show a warning as one line, without the place in the code."""
    print(f"warning: {one_line(message)}", file=sys.stderr)


def main() -> None:
    """Entry point of the command."""
    warnings.showwarning = _warn  # type: ignore[assignment]
    sys.exit(run(sys.argv[1:]))
