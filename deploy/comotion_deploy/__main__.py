"""``python -m comotion_deploy``: the command without its script, as the launcher starts it."""

from .cli import main

if __name__ == "__main__":
    main()
