"""Offline evaluation: recordings and scenes -> scores of the core, as a table or JSON."""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comotion import FusionConfig
from comotion_clients.joint_rows import known_values
from comotion_clients.metrics import Score
from comotion_clients.scoring import Summary
from comotion_clients.tum import save_paths
from comotion_schemas import HypothesisUpdate, Joint, encode
from comotion_schemas.errors import KnownError
from comotion_schemas.plain import plain
from comotion_schemas.terminal import Report, reporting
from comotion_schemas.text import counted

from .brox_malik import compare
from .inputs import Input
from .offline import OnUpdate, Run, run_offline
from .plot import Trace, save_plot
from .tables import Table, mean, number

_MEANS = (
    "mean_nmi",
    "final_nmi",
    "mean_misclassification",
    "final_misclassification",
    "mean_hypotheses",
    "mean_objects",
    "switches_per_100",
    "hota",
    "idf1",
    "id_switches",
    "ms_per_update",
)


@dataclass(frozen=True)
class Evaluated:
    """Summary of the run of one input; `digest`: SHA-256 of all encoded updates; joints of the last.

    `compared`: mean NMI of the comparator by clustering, if it was requested.
    """

    name: str
    seed: int | None
    summary: Summary
    ms_per_update: float
    ms_p99: float
    seconds: float
    digest: str
    joints: list[Joint]
    compared: dict[str, float]

    def values(self) -> dict[str, Any]:
        """Convert to plain numbers."""
        return {**asdict(self.summary), "ms_per_update": self.ms_per_update, "ms_p99": self.ms_p99}


def evaluate_inputs(
    inputs: Sequence[Input],
    config: FusionConfig,
    *,
    period: float | None = None,
    duration: float | None = None,
    plot: Path | None = None,
    paths: Path | None = None,
    comparator: bool = False,
) -> list[Evaluated]:
    """Run every input through the core.

    Parameters
    ----------
    inputs
        Inputs, see :func:`comotion_experiments.inputs.find_inputs`.
    config
        Parameters of the core.
    period, duration
        As in :func:`comotion_experiments.offline.run_offline`.
    plot
        Path of the plot; with several inputs the name of the input is added.
    paths
        Folder for paths in the TUM format; with several inputs one folder in it for each.
    comparator
        Score the affinity of Brox and Malik as well.

    Raises
    ------
    ValueError
        If an input has no observation, or is shorter than a period.
    """
    results: list[Evaluated] = []
    for count, given in enumerate(inputs, 1):
        trace, digest = Trace(), hashlib.sha256()
        name = f"{count}/{len(inputs)} {_label(given.name, 30)}"
        try:
            with reporting() as report:
                on_update = _tee(trace, digest, report, name)
                run = run_offline(given.open(), config, period=period, duration=duration, on_update=on_update)
        except ValueError as error:
            raise KnownError(f"{given.name}: {error}") from None
        compared = compare(given.open(), duration).means() if comparator else {}
        results.append(_evaluated(given, run, digest.hexdigest(), compared))
        if paths is not None:
            several = len(inputs) > 1
            save_paths(plot_path(paths / "paths", given, several=True) if several else paths, trace.updates)
        if plot is not None:
            _plot(plot_path(plot, given, several=len(inputs) > 1), given, config, run, trace)
    return results


def _tee(trace: Trace, digest: "hashlib._Hash", report: Report, name: str) -> OnUpdate:
    def on_update(update: HypothesisUpdate, score: Score) -> None:
        report(lambda: f"{name}: {counted(len(trace.updates), 'update')}, NMI {score.nmi:.2f}")
        trace.add(update, score)
        digest.update(encode(update))

    return on_update


def _evaluated(given: Input, run: Run, digest: str, compared: dict[str, float]) -> Evaluated:
    return Evaluated(
        name=given.name,
        seed=given.seed,
        summary=run.summary,
        ms_per_update=float(run.update_ms.mean()),
        ms_p99=float(np.percentile(run.update_ms, 99)),
        seconds=float(run.seconds[-1]),
        digest=digest,
        joints=run.last.joints,
        compared=compared,
    )


def _plot(path: Path, given: Input, config: FusionConfig, run: Run, trace: Trace) -> None:
    seed = "" if given.seed is None else f", seed {given.seed}"
    title = f"{Path(given.name).stem if given.seed is None else given.name}{seed}, method {config.method}"
    save_plot(path, title=title, updates=trace.updates, scores=run.scores, truth=run.truth, spaces=run.spaces)


def plot_path(path: Path, given: Input, *, several: bool) -> Path:
    """Return the path of the plot of an input: `path`, with the name of the input if there are several."""
    if not several:
        return path
    seed = "" if given.seed is None else f"-{given.seed}"
    name = Path(given.name.replace(":", "-")).stem
    return path.with_name(f"{path.stem}-{name}{seed}{path.suffix}")


def group(results: Sequence[Evaluated]) -> dict[str, list[Evaluated]]:
    """Group results by the name of the input, in order."""
    groups: dict[str, list[Evaluated]] = {}
    for result in results:
        groups.setdefault(result.name, []).append(result)
    return groups


def averages(results: Sequence[Evaluated]) -> dict[str, float]:
    """Mean of every number over the results that have it; NaN if none has."""
    rows = [result.values() for result in results]
    return {name: mean([row[name] for row in rows]) for name in _MEANS}


def overall(results: Sequence[Evaluated]) -> dict[str, float]:
    """Mean over files of the mean over seeds."""
    files = [averages(members) for members in group(results).values()]
    return {name: mean([file[name] for file in files]) for name in _MEANS}


def as_json(results: Sequence[Evaluated], config: FusionConfig, period: float | None) -> dict[str, Any]:
    """Values for JSON: parameters, one entry per run, and the mean over files."""
    values: dict[str, Any] = plain(
        {
            "config": config.model_dump(mode="json"),
            "period": config.period if period is None else period,
            "runs": [
                {
                    "file": r.name,
                    "seed": r.seed,
                    "seconds": r.seconds,
                    **r.values(),
                    "updates_sha256": r.digest,
                    "joints": [known_values(joint) for joint in r.joints],
                    **({"brox_malik": r.compared} if r.compared else {}),
                }
                for r in results
            ],
            "overall": overall(results),
        }
    )
    return values


def table(results: Sequence[Evaluated], *, everything: bool = False) -> Table:
    """Build a table with one row per file or scene (mean over seeds), and one for all.

    Not wider than 80 characters unless `everything` is asked for, or a comparator was scored.
    """
    groups = group(results)
    spreads = {name: [m.summary.mean_nmi for m in members] for name, members in groups.items()}
    seeded = any(len(values) > 1 for values in spreads.values())
    shown = [
        column for column in _COLUMNS if (everything or column.main) and (seeded or column.title != _SPREAD)
    ]
    drawn = Table(["file", *(column.title for column in shown), *_compared_titles(results)])
    for name, members in groups.items():
        row = averages(members) | {_SPREAD: _deviation(spreads[name])}
        drawn.add(_label(name, 28 if everything else 16), *_cells(row, shown), *_compared(members))
    if len(groups) > 1:
        drawn.end_section()
        drawn.add("overall", *_cells(overall(results) | {_SPREAD: math.nan}, shown), strong=True)
    return drawn


class _Column(NamedTuple):
    """A column of the table: which value, in how many digits, and whether it is among the main ones."""

    title: str
    value: str
    digits: int
    main: bool = False
    times: float = 1.0


_SPREAD = "± seeds"
_COLUMNS = (
    _Column("mean NMI", "mean_nmi", 3, main=True),
    _Column(_SPREAD, _SPREAD, 3, main=True),
    _Column("final NMI", "final_nmi", 3),
    _Column("error %", "mean_misclassification", 1, main=True, times=100),
    _Column("K found", "mean_hypotheses", 2, main=True),
    _Column("K true", "mean_objects", 2, main=True),
    _Column("switches/100", "switches_per_100", 2),
    _Column("HOTA", "hota", 3, main=True),
    _Column("IDF1", "idf1", 3),
    _Column("ID switches", "id_switches", 1),
    _Column("ms/update", "ms_per_update", 1, main=True),
)


def _cells(row: Mapping[str, float], columns: Sequence[_Column]) -> list[str]:
    return [number(column.times * row[column.value], column.digits) for column in columns]


def _deviation(values: Sequence[float]) -> float:
    return float(np.std(values)) if len(values) > 1 else math.nan


def _compared_titles(results: Sequence[Evaluated]) -> list[str]:
    return [f"Brox-Malik, {name}" for name in results[0].compared] if results else []


def _compared(members: Sequence[Evaluated]) -> list[str]:
    """Mean NMI of the comparator over seeds, by clustering."""
    return [number(mean([member.compared[name] for member in members]), 3) for name in members[0].compared]


def _label(name: str, width: int) -> str:
    short = name if name.startswith("sim:") else Path(name).name
    return short if len(short) <= width else "…" + short[1 - width :]
