"""What is in a checkout alone: the tools of ``comotion dev``, beside the tests."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from .options import Command

_TESTS = Path(__file__).parents[2] / "tests"


def in_checkout() -> bool:
    """Whether this is a checkout of the repository, not what a wheel installed."""
    return (_TESTS / "comotion_tools").is_dir()


def commands_of_checkout(group: Literal["TOOLS", "STUDIES"]) -> "dict[str, type[Command]]":
    """Commands beside the tests, which no wheel has; processes that are started from here find them too."""
    if not in_checkout():
        return {}
    if str(_TESTS) not in sys.path:
        sys.path.append(str(_TESTS))
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if str(_TESTS) not in paths:
        os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, paths), str(_TESTS)])
    from comotion_tools import commands

    return commands.TOOLS if group == "TOOLS" else commands.STUDIES
