"""Options of commands: a class a command, whose fields are options and whose ``run`` does the work.

A flag takes precedence over ``COMOTION_*`` in the environment, the environment over the file given by
``--config`` (:mod:`.config_file`), and the file over the default. Options that several commands share are in
a class that they extend: here, in :mod:`.network`, or beside the commands. A class attribute sets another
default for an option that a command inherits.
"""

import inspect
import json
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, dataclass_transform, get_args

import typer

from .config_file import file_table, read_config, spelling
from .errors import UserError

if TYPE_CHECKING:
    from comotion import FusionConfig

Result = TypeVar("Result")
_FROM_NAME = "COMOTION_"
_VALUES: dict[object, str] = {int: "N", float: "NUMBER", str: "TEXT", Path: "PATH"}
"""What stands for a value of a type in the help, unless an option says more."""


def option(default: Any, text: str, *names: str, env: str | None = None, **how: Any) -> Any:
    """Define an option as a field of a command.

    Parameters
    ----------
    default
        Its default; ``...``: it must be given.
    text
        Its help.
    names
        Its flags. Default: the name of the field, for a flag that is on also ``--no-NAME``.
    env
        Environment variable that sets it.
    how
        What :func:`typer.Option` takes: metavar, min, max, ...
    """
    metadata = {"names": names, "envvar": env, "help": text, **how}
    return field(default=MISSING if default is ... else default, metadata=metadata)


def setting(default: Any, text: str, *names: str, **how: Any) -> Any:
    """Define an :func:`option` that the environment sets too: as ``COMOTION_NAME``, or what `env` says."""
    return option(default, text, *names, **({"env": _FROM_NAME} | how))


def argument(default: Any, metavar: str, text: str) -> Any:
    """Define an argument as a field of a command; a default of ``...``: it must be given."""
    metadata = {"names": None, "metavar": metavar, "help": text, "show_default": default not in (None, ...)}
    return field(default=MISSING if default is ... else default, metadata=metadata)


@dataclass_transform(kw_only_default=True)
@dataclass(kw_only=True)
class Command:
    """A command: its docstring is the help, its fields are options, and :meth:`run` does the work.

    What extends it is a dataclass too.
    """

    ctx: typer.Context
    epilog: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        dataclass(kw_only=True)(cls)

    def prepare(self) -> None:
        """Do what the shared options ask for, before :meth:`run`."""

    def run(self) -> None:
        """Do the work."""
        raise NotImplementedError

    def call(self, work: Callable[..., Result], *given: Any, **others: Any) -> Result:
        """Call a function or a class with those of our fields that it takes, and with what is given."""
        own = {member.name for member in fields(self)}
        names = list(inspect.signature(work).parameters)[len(given) :]
        same = {name: getattr(self, name) for name in names if name in own}
        return work(*given, **(same | others))

    def reject_flags(self, names: tuple[str, ...], why: str) -> None:
        """Reject options on the command line that have no effect; environment and files may set them.

        `names` are fields of the command; `why` is the end of the message, after the option.

        Raises
        ------
        UserError
            If one of the options is on the command line.
        """
        for name in names:
            source = self.ctx.get_parameter_source(name)
            if source is not None and source.name == "COMMANDLINE":
                raise UserError(f"--{_words(name)} {why}")


def as_function(kind: type[Command]) -> Callable[..., None]:
    """Return a command as a function that typer understands, with a parameter for each option."""

    def call(**values: Any) -> None:
        command = kind(**values)
        command.prepare()
        command.run()

    parameters = [
        inspect.Parameter(
            member.name, inspect.Parameter.KEYWORD_ONLY, annotation=member.type, **_default(kind, member)
        )
        for member in _in_order(kind)
    ]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__doc__ = flowing(inspect.getdoc(kind) or "")
    return call


def add(app: typer.Typer, commands: Mapping[str, type[Command] | typer.Typer], panel: str = "") -> None:
    """Add commands and groups of commands to an app by their names, in a panel of its help."""
    for name, command in commands.items():
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, rich_help_panel=panel or None)
        else:
            epilog = flowing(command.epilog)
            app.command(name, epilog=epilog, rich_help_panel=panel or None)(as_function(command))


def flowing(text: str) -> str:
    """Join the lines of each paragraph, so that it fits any terminal; indented lines, as examples, stay."""
    return re.sub(r"(?<=\S)\n(?=\S)", " ", text)


def _in_order(kind: type[Command]) -> "list[Field[Any]]":
    """Arguments as they are defined; then the options of a command, and then of each class it extends."""
    left = {member.name: member for member in fields(kind)}
    arguments = [member for member in left.values() if member.metadata.get("names", ()) is None]
    names = dict.fromkeys(name for base in kind.__mro__ for name in inspect.get_annotations(base))
    return arguments + [left[name] for name in names if name in left and left[name] not in arguments]


def _default(kind: type[Command], member: "Field[Any]") -> dict[str, Any]:
    """The default of a parameter, which tells typer all about it; none for the context."""
    if not member.metadata:
        return {}
    how, default = dict(member.metadata), getattr(kind, member.name, ...)
    names = how.pop("names")
    if names is None:
        return {"default": typer.Argument(default, **how)}
    word = _words(member.name)
    if (value := _value(member.type)) is not None:
        how.setdefault("metavar", value)
    names = names or ((f"--{word}/--no-{word}",) if default is True else (f"--{word}",))
    if how["envvar"] == _FROM_NAME:
        flag = names[0].partition("/")[0]
        how["envvar"] = _FROM_NAME + flag.removeprefix("--").replace("-", "_").upper()
    return {"default": typer.Option(default, *names, **how)}


def _value(kind: Any) -> str | None:
    """The word for a value of a type, or of the items of a list; None for choices and flags."""
    inner = [argument for argument in get_args(kind) if argument is not NoneType]
    return _value(inner[0]) if inner else _VALUES.get(kind)


def _words(name: str) -> str:
    return name.rstrip("_").replace("_", "-")


class Logged(Command):
    """The option of every command that logs."""

    log_level: Literal["debug", "info", "warning", "error"] = setting(
        "info", "Least severity of messages on standard error."
    )

    def prepare(self) -> None:
        """Start logging."""
        import logging

        from comotion_schemas.text import LogFormatter

        handler = logging.StreamHandler()
        handler.setFormatter(LogFormatter("%(levelname)s: %(message)s"))
        logging.basicConfig(level=self.log_level.upper(), handlers=[handler])


class Tool(Logged):
    """Options of a command that needs no scene."""

    config: Path | None = setting(
        None, "Read options from a TOML file.", metavar="FILE.toml", is_eager=True, callback=read_config
    )


class Json(Command):
    """The option of a command that prints a result."""

    json_: bool = setting(False, "Print the result as JSON.")

    def show(self, values: object, *shown: object, width: int = 160) -> None:
        """Print a result.

        `values` are what :func:`comotion_schemas.plain.plain` takes, for JSON; otherwise lines, and what rich
        renders, are `shown`, in `width` characters where the output is no terminal.
        """
        from rich.console import Console

        from comotion_schemas.plain import plain

        if self.json_:
            print(json.dumps(plain(values), indent=2))
            return
        console = Console(width=None if sys.stdout.isatty() else width)
        for part in shown:
            (print if isinstance(part, str) else console.print)(part)


class Assignments(Command):
    """The option of a command that takes fusion parameters."""

    set_: list[str] | None = setting(
        None,
        "Set a fusion parameter; may be repeated. 'null' is None; see 'comotion config'.",
        metavar="NAME=VALUE",
    )

    def fusion_config(self, method: str | None = None) -> "FusionConfig":
        """Build the fusion parameters: ``[fusion]`` of the file, then `method`, then ``--set``.

        Raises
        ------
        UserError, ValueError
            For an unknown parameter or a value out of bounds.
        """
        from comotion.config import put, read_config

        table = _read_null(file_table(self.ctx, "fusion"))
        values = {spelling(name): value for name, value in table.items()}
        if method is not None:
            values["method"] = method
        for text in self.set_ or ():
            put(values, *assignment(text))
        return read_config(values)


class Fusion(Assignments):
    """Options of a command that groups features, by the method that it is given."""

    method: str | None = setting(None, "Method: comotion or thesis.")

    def fusion_config(self, method: str | None = None) -> "FusionConfig":
        """Build the fusion parameters, with ``--method``."""
        return super().fusion_config(method or self.method)


def _read_null(value: Any) -> Any:
    """None for TOML's "null", in tables too."""
    if isinstance(value, dict):
        return {key: _read_null(content) for key, content in value.items()}
    return None if value == "null" else value


def assignment(text: str, flag: str = "--set") -> tuple[str, Any]:
    """Parse ``NAME=VALUE`` of an option; the value is JSON, or else a text.

    Raises
    ------
    UserError
        If it is not of this form.
    """
    name, separator, value = text.partition("=")
    if not separator or not name:
        raise UserError(f"{flag} {text}: expected NAME=VALUE")
    try:
        return spelling(name.strip()), json.loads(value)
    except ValueError:
        return spelling(name.strip()), value
