"""Scores of regions, as Markdown and plain values."""

from collections.abc import Sequence
from typing import Any

from ..tables import Table, mean, plain, spread
from .experiment import METHODS, Scored


def markdown(results: Sequence[Scored]) -> str:
    """Build a table of IoU: mean over bodies and frames, and its standard deviation over seeds."""
    seeds = ", ".join(str(one) for one in sorted({r.seed for r in results}))
    found = Table(("scene", "object", *METHODS), words=2)
    for scene in dict.fromkeys(r.scene for r in results):
        runs = [r for r in results if r.scene == scene]
        for name, kind in (("bodies that have moved", "bodies"), ("background", "background")):
            scores = [[mean(getattr(r, kind)[method]) for r in runs] for method in METHODS]
            found.add(scene, name, *map(spread, scores))
    head = f"# Dense regions: results\n\nMade by `comotion dev reproduce regions`; seeds {seeds}."
    return f"{head}\n\n{found.markdown()}\n"


def as_json(results: Sequence[Scored]) -> Any:
    """All scores as plain values."""
    return plain(list(results))
