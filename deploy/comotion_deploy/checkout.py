"""What is in a checkout alone: the tools of ``comotion dev``, beside the tests."""

import os
import sys
from pathlib import Path

from .errors import UserError

_TESTS = Path(__file__).parents[2] / "tests"


def in_checkout() -> bool:
    """Whether this is a checkout of the repository, not what a wheel installed."""
    return (_TESTS / "comotion_tools").is_dir()


def require_checkout(command: str) -> None:
    """Make ``comotion_tools`` importable, here and in processes that are started from here.

    Raises
    ------
    UserError
        If comotion was installed from a wheel, which leaves the tools out.
    """
    if not in_checkout():
        raise UserError(
            f"'comotion dev {command}' needs a checkout of the repository: the wheel has what users run"
        )
    if str(_TESTS) not in sys.path:
        sys.path.append(str(_TESTS))
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if str(_TESTS) not in paths:
        os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, paths), str(_TESTS)])
