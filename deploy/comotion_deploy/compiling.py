"""Shows how far a warm-up is."""

from collections.abc import Iterable


def show_progress(name: str, steps: Iterable[None]) -> None:
    """Take the steps of a warm-up; a line on standard error shows how far it is."""
    from comotion.runtime.warm_up import STEPS
    from comotion_clients.progress import reporting

    with reporting(quiet=False, terminal_s=0.25, plain_s=3.0) as report:
        for number, _ in enumerate(steps, 1):
            text = f"{name}: step {number} of at most {STEPS}"
            report(text.__str__)
