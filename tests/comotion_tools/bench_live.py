"""``comotion dev bench --live``: starts router, service, three sources and a probe, and reads its result."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from comotion_deploy.demo import free_endpoint
from comotion_deploy.errors import UserError
from comotion_deploy.launcher import launch
from comotion_deploy.processes import PYTHON, ProcessSpec, comotion

_LEAD_S = 10.0  # until the sources start: all processes are then ready
_MODULE = "comotion_experiments.bench.live"


def run_live(features: int, seconds: float, fusion: Sequence[str], settle: float) -> dict[str, Any]:
    """Run the complete system and measure it.

    Parameters
    ----------
    features
        Features of the scene, over all sources.
    seconds
        Duration of the measurement.
    fusion
        Options of ``comotion serve``.
    settle
        Seconds from the first track to the start of the measurement, for the window to fill.

    Raises
    ------
    UserError
        If there is no result; the message has the last lines of the processes.
    """
    from comotion_experiments.bench.live import RESULT, SCENE, SOURCES

    endpoint = free_endpoint()
    with TemporaryDirectory(prefix="comotion-bench-") as name:
        folder = Path(name)
        start = time.time() + _LEAD_S
        common = (*PYTHON, _MODULE)
        sources = [
            ProcessSpec(
                name=f"s{k}",
                command=(*common, "source", endpoint, name, str(k), str(features), f"{start:.3f}"),
                restart="never",
            )
            for k in range(SOURCES)
        ]
        probe = (*common, "probe", endpoint, name, f"{seconds:g}", f"{settle:g}")
        launch(
            [
                comotion("router", "router", "--listen", endpoint),
                comotion("serve", "serve", "--no-state", *fusion, "--connect", endpoint, "--scene", SCENE),
                *sources,
                ProcessSpec(name="probe", command=probe, restart="never", foreground=True),
            ],
            log=folder / "log",
        )
        result = folder / RESULT
        if not result.exists():
            last = " | ".join((folder / "log").read_text(encoding="utf-8").splitlines()[-3:])
            raise UserError(f"no result; last lines: {last}")
        found: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
        return found


def live_lines(found: dict[str, Any]) -> list[str]:
    """Format the result as text."""
    seconds, updates, tracks = found["seconds"], found["updates"], found["tracks"]

    def spread(name: str) -> str:
        middle, p99, largest = found[name]
        return f"median {middle:.1f} ms, p99 {p99:.1f} ms, largest {largest:.1f} ms"

    counters = ", ".join(f"{value} {name}" for name, value in found["counters"].items())
    return [
        f"{tracks} tracks from three source processes, {updates} updates in {seconds:.0f} s",
        f"service: {counters}; {100 * found['cpu_share']:.0f} % of a core, {found['memory_mb']:.0f} MB",
        f"put of the last batch in an update to its receipt: {spread('last_batch')}",
        f"put of a batch to receipt of the first update that includes it: {spread('every_batch')}",
    ]
