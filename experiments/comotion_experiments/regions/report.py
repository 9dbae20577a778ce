"""Scores of regions, as Markdown and plain values."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from .experiment import METHODS, Scored


def markdown(results: Sequence[Scored]) -> str:
    """Build a table of IoU: mean over bodies and frames, and its standard deviation over seeds."""
    seeds = ", ".join(str(one) for one in sorted({r.seed for r in results}))
    lines = [
        "# Dense regions: results",
        "",
        f"Made by `comotion dev reproduce regions`; seeds {seeds}.",
        "",
        "| scene | object | " + " | ".join(METHODS) + " |",
        "|---|---|" + "---|" * len(METHODS),
    ]
    for scene in dict.fromkeys(r.scene for r in results):
        runs = [r for r in results if r.scene == scene]
        for name, kind in (("bodies that have moved", "bodies"), ("background", "background")):
            cells = [_spread([getattr(r, kind)[method] for r in runs]) for method in METHODS]
            lines.append(f"| {scene} | {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _spread(runs: Sequence[Sequence[float]]) -> str:
    means = [float(np.mean(one)) for one in runs if one]
    return f"{np.mean(means):.3f} ± {np.std(means):.3f}" if means else "-"


def as_json(results: Sequence[Scored]) -> list[dict[str, Any]]:
    """All scores as plain values."""
    return [asdict(one) for one in results]
