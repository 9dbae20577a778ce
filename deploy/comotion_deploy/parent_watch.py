"""``python -m comotion_deploy.parent_watch PARENT COMMAND...``: run a command that ends with its parent.

The kernel kills the process when its parent ends, even by SIGKILL (Linux only; the setting survives
the exec). A launcher that starts all its processes through this module leaves none running.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def _end_with_parent(parent: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # The parent may have ended before the setting took effect.
    if os.getppid() != parent:
        sys.exit(1)


def main() -> None:
    """Make this process end with its parent, then replace it by the command."""
    parent, *command = sys.argv[1:]
    _end_with_parent(int(parent))
    try:
        os.execvp(command[0], command)  # noqa: S606 - the command is the user's own
    except OSError as error:
        print(f"error: {command[0]}: {error.strerror}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
