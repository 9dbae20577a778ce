"""The tables of docs/research/attacks.md: what one source costs the others, and what a busy machine costs.

    PYTHONPATH=tests python -m adversary.table [--secure] [--seconds 20] [ATTACK...]

Without attacks every one of them, those that certificates do not keep out once more with certificates, and
then each scene of :mod:`.live`: half an hour on a quiet machine. Give it priority (``nice -n -10``) on
another. ``live`` as the only attack prints the second table alone.
"""

import argparse
import tempfile
from itertools import product
from pathlib import Path

from comotion_tools.soak.attacks import ATTACKS, WITHIN_LIMITS

from . import live
from .arena import COLUMNS, Arena

# Under the names of others, which access control denies.
_DENIED = ("names", "many-tokens")
SECURE = tuple(one for one in WITHIN_LIMITS if one not in _DENIED)


def main() -> None:
    """Print the tables, a line as it comes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--secure", action="store_true")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("attacks", nargs="*")
    chosen = parser.parse_args()
    runs = [(one, chosen.secure) for one in chosen.attacks if one != "live"]
    if not chosen.attacks:
        runs = [*((one, False) for one in ATTACKS), *((one, True) for one in SECURE)]
    if runs:
        _head(COLUMNS)
    for name, secure in runs:
        with tempfile.TemporaryDirectory() as folder, Arena(Path(folder), secure=secure) as arena:
            print(arena.attack(name, chosen.seconds), flush=True)
    if not runs or not chosen.attacks:
        _head(live.COLUMNS)
        for scene, share in product(live.SCENES, live.CORES):
            print(live.measure(scene, share, chosen.seconds), flush=True)


def _head(columns: str) -> None:
    names = columns.split(", ")
    print(f"\n| {' | '.join(names)} |\n{len(names) * '|---'}|", flush=True)


if __name__ == "__main__":
    main()
