"""Tells launchers and supervisors that a process is ready, and that it is alive.

Three listeners are served: the ready file or the line ``ready``, for launchers, containers and scripts; and
systemd's notification socket (``sd_notify``), for units with ``Type=notify`` and ``WatchdogSec``. The ready
file is touched with every beat, so that a health check can tell by its age whether the process hangs.
"""

import contextlib
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SOCKET = "NOTIFY_SOCKET"


@contextmanager
def announce_ready(ready_file: Path | None) -> Iterator[None]:
    """Signal readiness by a file or the line ``ready``, and to systemd; the file is removed at the end."""
    if ready_file is None:
        print("ready", flush=True)  # noqa: T201 - the contract with launchers and scripts
    else:
        # Replace in one step: readers never find an incomplete file.
        partial = ready_file.with_name(f".{ready_file.name}.{os.getpid()}")
        partial.write_text(f"{os.getpid()}\n")
        partial.replace(ready_file)
    _notify("READY=1")
    try:
        yield
    finally:
        _notify("STOPPING=1")
        if ready_file is not None:
            ready_file.unlink(missing_ok=True)


def beat(ready_file: Path | None) -> None:
    """Say that the process is alive; called about once a second, and not while it hangs."""
    if ready_file is not None:
        with contextlib.suppress(OSError):  # not ready yet, or the file was removed
            os.utime(ready_file)
    _notify("WATCHDOG=1")


def _notify(state: str) -> None:
    """Send a state to systemd, if it has started this process; a lost notification is not worth an error."""
    address = os.environ.get(_SOCKET)
    if not address:
        return
    if address.startswith("@"):
        address = f"\0{address[1:]}"
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(state.encode(), address)
