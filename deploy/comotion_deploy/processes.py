"""The processes of ``comotion up``, as tables ``[process.NAME]`` describe them."""

import shlex
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from comotion_schemas.errors import describe
from comotion_schemas.tls import ENVIRONMENT
from comotion_schemas.types import is_name

from .errors import UserError

Restart = Literal["always", "on-failure", "never"]
PYTHON = (sys.executable, "-m")
ENDS_WITH_PARENT = ("setpriv", "--pdeathsig", "KILL") if shutil.which("setpriv") else ()
"""Words before a command that the kernel kills when its parent ends, even by SIGKILL; of Linux alone."""


@dataclass(frozen=True, kw_only=True)
class ProcessSpec:
    """One process: its command, and what happens when it ends."""

    name: str
    command: tuple[str, ...]  # program and arguments
    restart: Restart = "on-failure"  # when to restart; ``on-failure``: unless it ended with status 0
    # The process writes the file named by ``COMOTION_READY_FILE`` when it is ready, as comotion commands do;
    # otherwise it counts as ready when it has started.
    says_ready: bool = True
    is_router: bool = False  # started before and stopped after all other processes
    # The process owns the terminal; when it ends with status 0, all processes are stopped.
    foreground: bool = False
    stop_s: float = 5.0  # seconds that the process may take to stop before it is killed
    env: Mapping[str, str] = field(default_factory=dict)


def comotion(name: str, *arguments: object, **options: Any) -> ProcessSpec:
    """Build the specification of a comotion command."""
    words = tuple(map(str, arguments))
    return ProcessSpec(
        name=name, command=(*PYTHON, "comotion_deploy", *words), is_router=words[0] == "router", **options
    )


def read_processes(content: Mapping[str, Any]) -> list[ProcessSpec]:
    """Parse the processes of a configuration file, in the order of the file.

    Raises
    ------
    UserError
        If there is no process, or a description is not valid.
    """
    tables = content.get("process")
    if not isinstance(tables, dict) or not tables:
        raise UserError("no processes: expected tables [process.NAME] with run = '...'")
    specs = [_read(name, table) for name, table in tables.items()]
    if sum(spec.foreground for spec in specs) > 1:
        raise UserError("more than one process has foreground = true")
    return specs


class _Table(BaseModel):
    """A table ``[process.NAME]``."""

    model_config = ConfigDict(extra="forbid", strict=True)

    run: str | list[str] | None = None
    command: str | list[str] | None = None
    restart: Restart = "on-failure"
    foreground: bool = False
    env: dict[str, str] = {}
    tls: str | None = None


def _read(name: str, content: Any) -> ProcessSpec:
    where = f"[process.{name}]"
    try:
        table = _Table.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{where}: {describe(error)}") from None
    if not is_name(name):
        raise UserError(f"{where}: a name is 1 to 64 characters of a-z, 0-9, _ and -")
    if (table.run is None) == (table.command is None):
        raise UserError(f"{where} needs either run (a comotion command) or command (any program)")
    options: dict[str, Any] = {
        "restart": table.restart,
        "foreground": table.foreground,
        "env": ({} if table.tls is None else {ENVIRONMENT: table.tls}) | table.env,
    }
    if table.run is not None:
        return comotion(name, *_words(where, table.run), **options)
    command = _words(where, table.command or "")
    if shutil.which(command[0]) is None:
        raise UserError(f"{where}: there is no program {command[0]!r}")
    return ProcessSpec(name=name, command=command, says_ready=False, **options)


def _words(where: str, value: str | list[str]) -> tuple[str, ...]:
    try:
        words = shlex.split(value) if isinstance(value, str) else value
    except ValueError as error:
        raise UserError(f"{where}: {error}") from None
    if not words:
        raise UserError(f"{where}: the command is empty")
    return tuple(words)
