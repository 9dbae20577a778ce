"""Process specifications of ``comotion up``: ``[process.NAME]`` tables -> processes."""

import shlex
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from comotion_schemas.tls import ENVIRONMENT
from comotion_schemas.types import is_name

from .errors import UserError

Restart = Literal["always", "on-failure", "never"]
PYTHON = (sys.executable, "-m")
_KEYS = frozenset({"run", "command", "restart", "foreground", "env", "tls"})


@dataclass(frozen=True, kw_only=True)
class ProcessSpec:
    """One process: its command, and what happens when it ends.

    Attributes
    ----------
    command
        Program and arguments.
    says_ready
        The process writes the file named by ``COMOTION_READY_FILE`` when it is ready, as comotion
        commands do; otherwise it counts as ready when it has started.
    is_router
        Started before and stopped after all other processes.
    restart
        When to restart; ``on-failure``: unless it ended with status 0.
    foreground
        The process owns the terminal; when it ends with status 0, all processes are stopped.
    stop_s
        Seconds that the process may take to stop before it is killed.
    """

    name: str
    command: tuple[str, ...]
    restart: Restart = "on-failure"
    says_ready: bool = True
    is_router: bool = False
    foreground: bool = False
    stop_s: float = 5.0
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


def _read(name: str, table: Any) -> ProcessSpec:
    where = f"[process.{name}]"
    if not isinstance(table, dict):
        raise UserError(f"{where} must be a table")
    unknown = sorted(set(table) - _KEYS)
    if unknown:
        raise UserError(f"{where} has no key {unknown[0]!r}; one of {', '.join(sorted(_KEYS))}")
    if not is_name(name):
        raise UserError(f"{where}: a name is 1 to 64 characters of a-z, 0-9, _ and -")
    options: dict[str, Any] = {
        "restart": _choice(where, table.get("restart", "on-failure")),
        "foreground": _flag(where, table.get("foreground", False)),
        "env": _certificate(where, table) | _env(where, table.get("env", {})),
    }
    if ("run" in table) == ("command" in table):
        raise UserError(f"{where} needs either run (a comotion command) or command (any program)")
    if "run" in table:
        return comotion(name, *_words(where, table["run"]), **options)
    command = _words(where, table["command"])
    if shutil.which(command[0]) is None:
        raise UserError(f"{where}: there is no program {command[0]!r}")
    return ProcessSpec(name=name, command=command, says_ready=False, **options)


def _words(where: str, value: Any) -> tuple[str, ...]:
    try:
        words = shlex.split(value) if isinstance(value, str) else [str(word) for word in value]
    except (TypeError, ValueError) as error:
        raise UserError(f"{where}: {error}") from None
    if not words:
        raise UserError(f"{where}: the command is empty")
    return tuple(words)


def _choice(where: str, value: Any) -> Restart:
    if value not in get_args(Restart):
        raise UserError(f"{where}: restart is one of {', '.join(get_args(Restart))}")
    choice: Restart = value
    return choice


def _flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise UserError(f"{where}: foreground is true or false")
    return value


def _certificate(where: str, table: Mapping[str, Any]) -> dict[str, str]:
    folder = table.get("tls")
    if folder is None:
        return {}
    if not isinstance(folder, str):
        raise UserError(f"{where}: tls is the folder of a component, as comotion pki issue makes it")
    return {ENVIRONMENT: folder}


def _env(where: str, value: Any) -> dict[str, str]:
    if not isinstance(value, dict) or not all(isinstance(item, str) for item in value.values()):
        raise UserError(f"{where}: env is a table of strings")
    return value
