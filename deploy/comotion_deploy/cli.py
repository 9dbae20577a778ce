"""The command ``comotion``: registers its commands and reports their errors."""

import json
import logging
import sys
import tomllib
import warnings
from collections.abc import Sequence
from importlib import metadata

import typer

from .commands import (
    bench,
    calibrate,
    config,
    demo,
    evaluate,
    fleet,
    joints,
    pki,
    record,
    reproduce,
    ros2,
    router,
    segment,
    serve,
    soak,
    source,
    status,
    up,
    view,
    warm_up,
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


app.command("demo", epilog=demo.EPILOG)(demo.demo)
app.command("up", epilog=up.EPILOG)(up.up)
app.command("serve", epilog=serve.EPILOG)(serve.serve)
app.add_typer(source.app, name="source")
app.add_typer(fleet.app, name="fleet")
app.command("router", epilog=router.EPILOG)(router.router)
app.add_typer(pki.app, name="pki")
app.command("ros2", epilog=ros2.EPILOG)(ros2.ros2)
app.command("segment", epilog=segment.EPILOG)(segment.segment)
app.command("status", epilog=status.EPILOG)(status.status)
app.command("watch", epilog=watch.EPILOG)(watch.watch)
app.command("view", epilog=view.EPILOG)(view.view)
app.command("record", epilog=record.EPILOG)(record.record)
app.command("evaluate", epilog=evaluate.EPILOG)(evaluate.evaluate)
app.command("joints", epilog=joints.EPILOG)(joints.joints)
app.command("calibrate", epilog=calibrate.EPILOG)(calibrate.calibrate)
app.add_typer(reproduce.app, name="reproduce")
app.command("bench", epilog=bench.EPILOG)(bench.bench)
app.command("soak", epilog=soak.EPILOG)(soak.soak)
app.command("warm-up", epilog=warm_up.EPILOG)(warm_up.warm_up)
app.command("config", epilog=config.EPILOG)(config.config)


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit status: 0, 2 for a known error, 130 if interrupted.

    Any other error is a defect; its traceback is shown.
    """
    try:
        result = helped(app, arguments)(prog_name="comotion", standalone_mode=False)
    except typer.TyperException as error:
        return _fail(error.format_message(), error)
    except (UserError, OSError) as error:
        return _fail(error, error)
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
