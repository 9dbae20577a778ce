"""The router process: Zenoh in router mode."""

import threading
from pathlib import Path
from typing import Any

import zenoh

from comotion_schemas.component import announce_ready, stop_on_signals
from comotion_schemas.transport import SessionSettings, open_session

from .errors import UserError

ZENOH_TABLES = frozenset({"access_control", "low_pass_filter", "downsampling", "qos"})
"""Tables of the Zenoh configuration that ``[zenoh]`` may set; the session settings fix the others."""


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


def run_router(settings: SessionSettings, overrides: dict[str, Any], ready_file: Path | None) -> None:
    """Route messages until SIGINT or SIGTERM.

    Raises
    ------
    UserError
        If the router cannot listen, or Zenoh rejects the settings.
    """
    stop = threading.Event()
    with stop_on_signals(stop):
        try:
            session = open_session(settings, overrides)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]
            raise UserError(f"cannot listen at {', '.join(settings.listen)}: {reason}") from None
        with session, announce_ready(ready_file):
            stop.wait()
