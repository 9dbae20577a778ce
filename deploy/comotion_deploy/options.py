"""Options of commands: a class a command, whose fields are options and whose ``run`` does the work.

A flag takes precedence over ``COMOTION_*`` in the environment, the environment over the file given by
``--config`` (:mod:`.config_file`), and the file over the default. Options that several commands share are in
a class that they extend: those of processes and clients here, others beside the commands. A class attribute
sets another default for an option that a command inherits.
"""

import inspect
import re
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, dataclass_transform, get_args

import typer

from .config_file import read_config
from .errors import UserError
from .network import OPEN_METRICS, require_closed, session_settings

if TYPE_CHECKING:
    from comotion_schemas.component import Where
    from comotion_schemas.transport import SessionSettings

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

        Parameters
        ----------
        names
            Fields of the command.
        why
            End of the message, after the option.

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

        Parameters
        ----------
        values
            What :func:`comotion_schemas.plain.plain` takes, for JSON.
        shown
            Otherwise: lines, and what rich renders.
        width
            Characters of what rich renders where the output is no terminal.
        """
        import json

        from rich.console import Console

        from comotion_schemas.plain import plain

        if self.json_:
            print(json.dumps(plain(values), indent=2))
            return
        console = Console(width=None if sys.stdout.isatty() else width)
        for part in shown:
            if isinstance(part, str):
                print(part)
            else:
                console.print(part)


class Ready(Command):
    """The option of a command that says when it is ready."""

    ready_file: Path | None = setting(
        None, "Write this file when ready, instead of printing 'ready'.", metavar="PATH"
    )


class Session(Logged):
    """Options of a command that connects to a router."""

    connect: list[str] | None = setting(
        None, "Router to connect to; may be repeated. Default: tcp/127.0.0.1:7447.", metavar="ENDPOINT"
    )
    tls: Path | None = setting(
        None, "Connect with the certificate in this folder, made by 'comotion pki issue'.", metavar="DIR/NAME"
    )

    def settings(self) -> "SessionSettings":
        """Return the settings of its session."""
        return session_settings(self.connect, tls=self.tls)


class Client(Session, Tool):
    """Options of a command that looks at a scene."""

    scene: str = setting("default", "Scene: one service and its sources.")


class Present(Ready, Client):
    """Options of a command that is seen in the scene while it runs."""

    def where(self) -> "Where":
        """Return where its component runs, and how it says that it is ready."""
        return {"scene": self.scene, "settings": self.settings(), "ready_file": self.ready_file}


class Process(Present):
    """Options of a process that is part of a scene."""

    name: str | None = setting(
        None, "Name of the source. With a certificate: its name.", env="COMOTION_SOURCE_NAME"
    )
    # Not from the environment, which is the router's: another process would take its port.
    listen: list[str] | None = option(
        None, "Also act as a router, at this endpoint; may be repeated.", metavar="ENDPOINT"
    )
    insecure: bool = setting(False, "Allow to listen where other machines can connect, without certificates.")
    metrics_port: str | None = setting(
        None,
        "Serve Prometheus metrics, by default on 127.0.0.1; 0 chooses a free port.",
        metavar="[HOST:]PORT",
    )

    def prepare(self) -> None:
        """Start logging, take the name in the certificate, and serve metrics."""
        super().prepare()
        given = self.ctx.get_parameter_source("name")
        if self.tls is not None and (given is None or given.name == "DEFAULT"):
            from comotion_schemas.tls import load_tls

            with suppress(ValueError):  # said when the session is opened
                identity = load_tls(self.tls).identity
                self.name = self.name if identity is None else identity.name
        if self.metrics_port is not None:
            from comotion_schemas import metrics

            host, port = metrics.parse_address(self.metrics_port)
            require_closed([f"{host}:{port}"], OPEN_METRICS, insecure=self.insecure)
            port = metrics.expose(host, port)
            print(f"metrics at http://{host}:{port}/metrics", file=sys.stderr, flush=True)

    def settings(self) -> "SessionSettings":
        """Return the settings of its session."""
        return session_settings(self.connect, self.listen, self.tls, insecure=self.insecure)


def host_name() -> str:
    """The name of this host, as a name of the protocol."""
    return re.sub(r"[^a-z0-9_-]+", "-", socket.gethostname().lower())[:48] or "host"


def urls(text: str | None) -> tuple[str, ...]:
    """Split urls that are separated by commas."""
    return tuple(url.strip() for url in (text or "").split(",") if url.strip())
