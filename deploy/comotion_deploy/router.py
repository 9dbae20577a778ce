"""The router process: Zenoh in router mode."""

import logging
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from comotion_schemas.component import stop_on_signals
from comotion_schemas.readiness import announce_ready, beat
from comotion_schemas.transport import SessionSettings, open_session

from .errors import UserError, one_line

ZENOH_TABLES = frozenset({"access_control", "low_pass_filter", "downsampling", "qos"})
"""Tables of the Zenoh configuration that ``[zenoh]`` may set; the session settings fix the others."""
_POLL_S = 0.2
_REOPEN_S = 5.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RouterSetup:
    """How a router connects, and the tables of Zenoh's configuration beside that."""

    settings: SessionSettings
    overrides: dict[str, Any]


def zenoh_overrides(table: dict[str, Any], max_message_bytes: int | None) -> dict[str, Any]:
    """Build the Zenoh settings of the router from ``[zenoh]`` and ``--max-message-bytes``.

    Raises
    ------
    UserError
        If a table is not allowed, or the limit is set twice.
    """
    unknown = sorted(set(table) - ZENOH_TABLES)
    if unknown:
        raise UserError(f"[zenoh] has no table {unknown[0]!r}; one of {', '.join(sorted(ZENOH_TABLES))}")
    if max_message_bytes is None:
        return dict(table)
    if "low_pass_filter" in table:
        raise UserError("--max-message-bytes and [[zenoh.low_pass_filter]] exclude each other")
    rule = {
        "id": "max-message",
        "flows": ["ingress"],
        "messages": ["put"],
        "key_exprs": ["comotion/@v1/**"],
        "size_limit": max_message_bytes,
    }
    return table | {"low_pass_filter": [rule]}


def run_router(set_up: Callable[[], RouterSetup], ready_file: Path | None) -> None:
    """Route messages until SIGINT or SIGTERM; SIGHUP restarts the router with what `set_up` then returns.

    If `set_up` fails at a restart, the router goes on as it is.

    Raises
    ------
    UserError
        If the router cannot listen, or Zenoh rejects the settings.
    """
    stop = threading.Event()
    setup = set_up()
    hang_ups: list[int] = []
    with stop_on_signals(stop), ExitStack() as restored, ExitStack() as opened:
        previous = signal.signal(signal.SIGHUP, lambda number, _frame: hang_ups.append(number))
        restored.callback(signal.signal, signal.SIGHUP, previous)
        opened.enter_context(_open(setup))
        with announce_ready(ready_file):
            while not stop.wait(_POLL_S):
                beat(ready_file)
                if hang_ups:
                    hang_ups.clear()
                    _restart(opened, set_up)


def _restart(opened: ExitStack, set_up: Callable[[], RouterSetup]) -> None:
    """Replace the open session; nothing happens if the new settings are not valid."""
    try:
        setup = set_up()
    except (UserError, ValueError, OSError) as error:
        _log.error("not restarted: %s", one_line(error))
        return
    opened.close()
    until = time.monotonic() + _REOPEN_S
    while True:
        try:
            opened.enter_context(_open(setup))
        except UserError:  # the system may still hold the port
            if time.monotonic() > until:
                raise
            time.sleep(0.05)
        else:
            _log.info("restarted")
            return


def _open(setup: RouterSetup) -> zenoh.Session:
    try:
        return open_session(setup.settings, setup.overrides)
    except zenoh.ZError as error:
        reason = str(error).split(" at /")[0]
        raise UserError(f"cannot listen at {', '.join(setup.settings.listen)}: {reason}") from None
