"""``comotion dev bench``: time and memory of the core on this machine."""

import os
from functools import partial
from pathlib import Path

from comotion_deploy.commands.experiments import progress
from comotion_deploy.errors import UserError
from comotion_deploy.options import Assignments, option

from .studies import Experiment


class Bench(Assignments, Experiment):
    """Time the core on generated scenes of any size: ms per update, CPU, memory."""

    epilog = """
Examples:
  comotion dev bench --quick
  comotion dev bench --features 500,1000,3000 --method thesis --updates 100
  comotion dev bench --features 1000 --rate 15,30,60 --json
  comotion dev bench --pixels --sources 1 --method comotion --features 500,1000   # one plain camera
"""
    out = Path("out/bench")

    features: str | None = option(None, "Numbers of features. Default: 500,1000,3000,5000; quick 200,500.")
    method: list[str] | None = option(None, "Method; may be repeated. Default: comotion and thesis.")
    rate: str = option("30", "Hz of every source; several make more rows.")
    updates: int | None = option(None, "Updates to time per row.", min=2)
    sources: int = option(3, "Sources of the scene.", min=1, max=64)
    pixels: bool = option(False, "Plain cameras: a space in px for each of the sources.")
    quick: bool = option(False, "Small numbers, few updates.")

    def run(self) -> None:
        """Measure the core and print the result."""
        from comotion_tools.bench import SceneSpec, markdown, run_bench, this_machine

        # Threads of parallel kernels spin for some tens of microseconds before they sleep.
        os.environ.setdefault("GOMP_SPINCOUNT", "50000")
        scene = partial(SceneSpec, sources=self.sources, pixels=self.pixels)
        features = self.features or ("200,500" if self.quick else "500,1000,3000,5000")
        sizes = numbers("--features", features, 2, 50_000)
        rates = numbers("--rate", self.rate, 1, 1000)
        with progress() as note:
            rows = run_bench(
                [scene(features=size, rate=rate) for size in sizes for rate in rates],
                [self.fusion_config(name) for name in self.method or ("comotion", "thesis")],
                self.updates or (20 if self.quick else 100),
                note,
            )
        machine = this_machine()
        self.report("bench", markdown(rows, machine), {"machine": machine, "rows": rows})


def numbers(option: str, text: str, least: int, most: int) -> list[int]:
    """Parse whole numbers, separated by commas.

    Raises
    ------
    UserError
        If one is not from `least` to `most`.
    """
    chunks = [chunk.strip() for chunk in text.split(",")]
    if not all(chunk.isdecimal() and least <= int(chunk) <= most for chunk in chunks):
        raise UserError(f"{option} {text}: expected numbers from {least} to {most}, separated by commas")
    return [int(chunk) for chunk in chunks]
