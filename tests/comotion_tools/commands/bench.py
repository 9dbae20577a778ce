"""``comotion dev bench``: time, memory and latency of the core on this machine."""

import os
from pathlib import Path

from comotion_deploy.commands.experiments import progress
from comotion_deploy.errors import UserError
from comotion_deploy.fusion_options import Assignments
from comotion_deploy.options import Json, Tool, option


class Bench(Assignments, Json, Tool):
    """Time the core on generated scenes of any size: ms per update, CPU, memory."""

    epilog = """
Examples:
  comotion dev bench --quick
  comotion dev bench --features 500,1000,3000 --method thesis --updates 100
  comotion dev bench --features 1000 --rate 15,30,60 --recording tennis_serve.npz --json
  comotion dev bench --pixels --sources 1 --method comotion --features 500,1000   # one plain camera
  comotion dev bench --out docs/research   # writes performance.md and its picture
  comotion dev bench --live --features 1000 --seconds 60   # processes over a router: latency, overruns, CPU
"""
    log_level = "warning"

    features: str | None = option(
        None, "Numbers of features. Default: 500,1000,3000,5000; quick 200,500; live 1000."
    )
    method: list[str] | None = option(None, "Method; may be repeated. Default: comotion and thesis.")
    rate: str = option("30", "Hz of every source; several make more rows.")
    recording: list[str] | None = option(
        None, "Time a recording or sim:NAME too; repeatable.", metavar="FILE"
    )
    updates: int | None = option(None, "Updates to time per row.", min=2)
    bodies: int = option(6, "Moving bodies of the scene.", min=1)
    sources: int = option(3, "Sources of the scene.", min=1, max=64)
    churn: float = option(0.03, "Share of the features replaced per second.", min=0, max=1)
    seed: int = option(0, "Seed of the scene.", min=0)
    pixels: bool = option(False, "Plain cameras: a space in px for each of the sources.")
    quick: bool = option(False, "Small numbers, few updates.")
    live: bool = option(False, "Measure processes over a router instead.")
    seconds: float = option(30.0, "Of --live.", min=1)
    out: Path | None = option(
        None, "Write performance.md and images/performance.png there.", metavar="DIR", file_okay=False
    )

    def run(self) -> None:
        """Measure the core, or processes over a router, and print or write the result."""
        from comotion_tools.bench.experiment import run_bench
        from comotion_tools.bench.report import lines, save, table
        from comotion_tools.bench.scene import SceneSpec

        # Threads of parallel kernels spin for some tens of microseconds before they sleep.
        os.environ.setdefault("GOMP_SPINCOUNT", "50000")
        if self.live:
            self._run_live()
            return
        if self.out is not None:
            import matplotlib  # noqa: F401 - before the work
        like = {name: getattr(self, name) for name in ("bodies", "sources", "churn", "seed", "pixels")}
        features = self.features or ("200,500" if self.quick else "500,1000,3000,5000")
        sizes = numbers("--features", features, 2, 50_000)
        rates = numbers("--rate", self.rate, 1, 1000)
        with progress() as note:
            costs = run_bench(
                [SceneSpec(features=size, rate=rate, **like) for size in sizes for rate in rates],
                [self.fusion_config(name) for name in self.method or ("comotion", "thesis")],
                self.updates or (20 if self.quick else 100),
                recordings=self.recording or (),
                progress=note,
            )
        written = [f"written: {save(self.out, costs)}"] if self.out is not None else []
        self.show(costs.as_json(), table(costs), *lines(costs), *written)

    def _run_live(self) -> None:
        from comotion_tools.bench.live import live_lines, run_live

        words = [word for name in self.method or () for word in ("--method", name)]
        words += [word for text in self.set_ or () for word in ("--set", text)]
        results, shown = [], []
        for size in numbers("--features", self.features or "1000", 2, 50_000):
            most = ["--set", f"max_tracks={max(5000, 2 * size)}"]
            results.append(run_live(size, self.seconds, [*most, *words], 12.0))
            shown += live_lines(results[-1])
        self.show(results, *shown)


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
