"""Runs and draws figures one by one and collects their numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..processes import Progress, quiet
from .figure import Drawn, Figure
from .panels import mean_and_spread
from .runs import SceneRuns
from .study import Options, Study


@dataclass(frozen=True)
class Made:
    """A figure, its picture, and what else came of drawing it."""

    figure: Figure
    picture: Path
    drawn: Drawn


@dataclass
class Results:
    """Figures made, figures left out for want of the workcell, and the options of the run."""

    options: Options
    made: list[Made] = field(default_factory=list)
    left_out: list[Figure] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Everything, for JSON; a curve has seconds `t`, and `mean` and `std` of NMI over the seeds."""
        return {
            "seeds": self.options.seeds,
            "workcell_seeds": self.options.workcell_seeds,
            "quick": self.options.quick,
            "default_method": self.options.default.model_dump(mode="json"),
            "left_out": [figure.name for figure in self.left_out],
            "figures": {
                made.figure.name: {
                    "title": made.figure.title,
                    "picture": made.picture.name,
                    "numbers": made.drawn.rows,
                    "parameters": made.drawn.parameters,
                    "curves": {label: _curve(take) for label, take in made.drawn.curves.items()},
                }
                for made in self.made
            },
        }


def reproduce(
    figures: Sequence[Figure],
    options: Options,
    out: Path,
    *,
    workcell: bool = True,
    note: Progress = quiet,
) -> Results:
    """Run and draw figures.

    Parameters
    ----------
    figures
        The figures, in order.
    options
        Seeds, size and parameters.
    out
        Folder of the pictures; made if it does not exist.
    workcell
        Whether MuJoCo is installed; otherwise figures of the workcell are left out.
    note
        Called with the name of the next run.
    """
    out.mkdir(parents=True, exist_ok=True)
    results = Results(options, left_out=[figure for figure in figures if figure.workcell and not workcell])
    chosen = [figure for figure in figures if figure not in results.left_out]
    study = Study(options)
    for number, figure in enumerate(chosen, 1):
        place = f"[{number}/{len(chosen)}] figure {figure.name}"
        note(place)
        study.note = lambda what, place=place: note(f"{place}: {what}")  # type: ignore[misc]
        drawn = figure.draw(study)
        picture = out / figure.file
        drawn.figure.savefig(picture)
        results.made.append(Made(figure, picture, drawn))
    return results


def _curve(take: SceneRuns) -> dict[str, list[float]]:
    mean, spread = mean_and_spread(take.nmi)
    return {"t": _rounded(take.t), "mean": _rounded(mean), "std": _rounded(spread)}


def _rounded(values: Any) -> list[float]:
    """To four digits; NaN where a value is masked."""
    rounded: list[float] = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan).round(4).tolist()
    return rounded
