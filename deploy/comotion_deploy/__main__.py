"""``python -m comotion_deploy``: the command ``comotion`` without its script; the launcher uses it."""

from .cli import main

if __name__ == "__main__":
    main()
