"""What ``comotion dev bench`` does: measures, prints tables and writes pages."""

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from comotion_deploy.commands.experiments import check
from comotion_schemas.errors import KnownError

from . import report
from .experiment import Costs, run_bench, scaled
from .live import live_lines, run_live
from .scene import SceneSpec

if TYPE_CHECKING:
    from ..commands.bench import Bench


def bench(options: "Bench") -> None:
    """Measure the core, or processes over a router."""
    # Threads of parallel kernels spin for some tens of microseconds before they sleep.
    os.environ.setdefault("GOMP_SPINCOUNT", "50000")
    if options.live:
        _live(options)
        return
    if options.out is not None:
        check(options.out)
    _core(options)


def _core(options: "Bench") -> None:
    quick = options.quick
    spec = SceneSpec(
        bodies=options.bodies,
        sources=options.sources,
        churn=options.churn,
        seed=options.seed,
        pixels=options.pixels,
    )
    features = options.features or ("200,500" if quick else "500,1000,3000,5000")
    sizes = numbers("--features", features, 2, 50_000)
    status = Console(stderr=True)
    costs = run_bench(
        scaled(spec, sizes, numbers("--rate", options.rate, 1, 1000)),
        [options.fusion_config(name) for name in options.method or ("comotion", "thesis")],
        options.updates or (20 if quick else 100),
        recordings=options.recording or (),
        progress=lambda what: status.print(what, style="dim", highlight=False),
    )
    _report(costs, options.out, as_json=options.json_)


def _report(costs: Costs, out: Path | None, *, as_json: bool) -> None:
    if out is not None:
        (out / "images").mkdir(parents=True, exist_ok=True)
        report.save_picture(out / "images" / "performance.png", costs)
        text = report.markdown(costs, "images/performance.png", _command())
        report.write_page(out / "performance.md", text)
    if as_json:
        print(json.dumps(costs.as_json(), indent=2))
        return
    console = Console(width=max(120, Console().width))
    console.print(report.table(costs))
    for line in report.lines(costs):
        console.print(line, highlight=False)
    if out is not None:
        console.print(f"written: {out / 'performance.md'}", highlight=False)


def _command() -> str:
    """Return the command line; files without their folders, since the page is for other machines."""
    return " ".join(
        ["comotion", *(Path(word).name if Path(word).is_file() else word for word in sys.argv[1:])]
    )


def _live(options: "Bench") -> None:
    results = []
    for size in numbers("--features", options.features or "1000", 2, 50_000):
        words = ["--set", f"max_tracks={max(5000, 2 * size)}", *_serve_words(options)]
        results.append(run_live(size, options.seconds, words, 12.0))
        if not options.json_:
            print("\n".join(live_lines(results[-1])))
    if options.json_:
        print(json.dumps(results, indent=2))


def _serve_words(options: "Bench") -> list[str]:
    """Options of ``comotion serve``."""
    words = [word for name in options.method or () for word in ("--method", name)]
    return words + [word for text in options.set_ or () for word in ("--set", text)]


def numbers(option: str, text: str, least: int, most: int) -> list[int]:
    """Parse whole numbers, separated by commas.

    Raises
    ------
    KnownError
        If one is not from `least` to `most`.
    """
    chunks = [chunk.strip() for chunk in text.split(",")]
    if not all(chunk.isdecimal() and least <= int(chunk) <= most for chunk in chunks):
        raise KnownError(f"{option} {text}: expected numbers from {least} to {most}, separated by commas")
    return [int(chunk) for chunk in chunks]
