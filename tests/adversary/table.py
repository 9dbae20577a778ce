"""Every attack once, and none: ``PYTHONPATH=tests python -m adversary.table [--secure] [ATTACK...]``."""

import sys
import tempfile
from pathlib import Path

from comotion_tools.soak.attacks import ATTACKS

from .arena import Arena

SECONDS = 10.0


def main(chosen: list[str]) -> None:
    secure = "--secure" in chosen
    for name in [one for one in chosen if one != "--secure"] or ATTACKS:
        with tempfile.TemporaryDirectory() as folder, Arena(Path(folder), secure=secure) as arena:
            print(arena.attack(name, SECONDS), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
