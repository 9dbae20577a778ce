"""The table of docs/research/attacks.md: what one source costs the others.

    PYTHONPATH=tests python -m adversary.table [--secure] [--seconds 20] [ATTACK...]

Without attacks every one of them, and those that certificates do not keep out once more with certificates:
a quarter of an hour on a quiet machine. Give it priority (``nice -n -10``) on another.
"""

import argparse
import tempfile
from pathlib import Path

from comotion_tools.soak.attacks import ATTACKS, WITHIN_LIMITS

from .arena import COLUMNS, Arena

# Under the names of others, which access control denies.
_DENIED = ("names", "many-tokens")
SECURE = tuple(one for one in WITHIN_LIMITS if one not in _DENIED)


def main() -> None:
    """Print the table, a line as it comes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--secure", action="store_true")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("attacks", nargs="*")
    chosen = parser.parse_args()
    runs = [(one, chosen.secure) for one in chosen.attacks]
    if not runs:
        runs = [*((one, False) for one in ATTACKS), *((one, True) for one in SECURE)]
    print(f"| {COLUMNS.replace(', ', ' | ')} |\n{8 * '|---'}|", flush=True)
    for name, secure in runs:
        with tempfile.TemporaryDirectory() as folder, Arena(Path(folder), secure=secure) as arena:
            print(arena.attack(name, chosen.seconds), flush=True)


if __name__ == "__main__":
    main()
