"""``comotion dev bench``: time, memory and latency of the core on this machine."""

from dataclasses import dataclass
from pathlib import Path

from comotion_deploy.fusion_options import Assignments
from comotion_deploy.options import Json, Tool, option


@dataclass(kw_only=True)
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
    out: Path | None = option(None, "Write performance.md and images/performance.png there.", metavar="DIR")

    def run(self) -> None:
        """Measure, and print or write the result."""
        from comotion_tools.bench.command import bench

        bench(self)
