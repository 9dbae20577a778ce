"""Runs and draws figures one by one and collects their numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..study import Progress, quiet
from .panels import mean_and_spread
from .runs import SceneRuns
from .study import Drawn, Figure, Options, Study


@dataclass
class Results:
    """Figures with what came of drawing them, figures left out for want of the workcell, and the options.

    The pictures are in the folder `out`.
    """

    options: Options
    out: Path
    made: list[tuple[Figure, Drawn]] = field(default_factory=list)
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
                figure.name: {
                    "title": figure.title,
                    "picture": figure.file,
                    "numbers": drawn.rows,
                    "parameters": drawn.parameters,
                    "curves": {label: _curve(take) for label, take in drawn.curves.items()},
                }
                for figure, drawn in self.made
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
    """Run and draw figures in order, their pictures in a folder that is made if it does not exist.

    Parameters
    ----------
    figures, options, out
        The figures; seeds, size and parameters; the folder.
    workcell
        Whether MuJoCo is installed; otherwise figures of the workcell are left out.
    note
        Called with the name of the next run.
    """
    out.mkdir(parents=True, exist_ok=True)
    left_out = [figure for figure in figures if figure.workcell and not workcell]
    results = Results(options, out, left_out=left_out)
    chosen = [figure for figure in figures if figure not in left_out]
    study = Study(options)
    for number, figure in enumerate(chosen, 1):
        place = f"[{number}/{len(chosen)}] figure {figure.name}"
        note(place)
        study.note = lambda what, place=place: note(f"{place}: {what}")  # type: ignore[misc]
        drawn = figure.draw(study)
        drawn.figure.savefig(out / figure.file)
        results.made.append((figure, drawn))
    return results


def _curve(take: SceneRuns) -> dict[str, list[float]]:
    """To four digits; NaN where a value is masked."""
    mean, spread = mean_and_spread(take.nmi)
    columns = {"t": take.t, "mean": mean, "std": spread}
    return {name: np.ma.filled(column, np.nan).round(4).tolist() for name, column in columns.items()}
