"""Scores recordings and scenes offline, as a table or JSON."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_clients.formats import save_paths
from comotion_clients.metrics import Score
from comotion_schemas import HypothesisUpdate, encode
from comotion_schemas.errors import KnownError
from comotion_schemas.plain import plain
from comotion_schemas.terminal import Report, reporting
from comotion_schemas.text import counted

from .brox_malik import compare
from .inputs import Input
from .offline import OnUpdate, Run, run_offline
from .plot import Trace, save_plot
from .tables import Column, Table, means


@dataclass(frozen=True)
class Evaluated:
    """The run of one input; `digest`: SHA-256 of all encoded updates.

    `compared`: mean NMI of the comparator by clustering, if it was requested.
    """

    name: str
    seed: int | None
    run: Run
    digest: str
    compared: dict[str, float]

    def values(self) -> dict[str, Any]:
        """Convert to plain numbers."""
        ms = self.run.update_ms
        costs = {"ms_per_update": float(ms.mean()), "ms_p99": float(np.percentile(ms, 99))}
        return asdict(self.run.summary) | costs


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
    several = len(inputs) > 1
    for count, given in enumerate(inputs, 1):
        trace, digest = Trace(), hashlib.sha256()
        name = f"{count}/{len(inputs)} {_label(given.name, 30)}"
        try:
            with reporting() as report:
                on_update = _tee(trace, digest, report, name)
                run = run_offline(given.open(), config, period=period, duration=duration, on_update=on_update)
        except ValueError as error:
            raise KnownError(f"{given.name}: {error}") from None
        compared = compare(given.open(), duration) if comparator else {}
        results.append(Evaluated(given.name, given.seed, run, digest.hexdigest(), compared))
        if paths is not None:
            save_paths(plot_path(paths / "paths", given, several=True) if several else paths, trace.updates)
        if plot is not None:
            title = Path(given.name).stem if given.seed is None else f"{given.name}, seed {given.seed}"
            save_plot(plot_path(plot, given, several=several), f"{title}, method {config.method}", trace, run)
    return results


def _tee(trace: Trace, digest: "hashlib._Hash", report: Report, name: str) -> OnUpdate:
    def on_update(update: HypothesisUpdate, score: Score) -> None:
        report(lambda: f"{name}: {counted(len(trace.updates), 'update')}, NMI {score.nmi:.2f}")
        trace.add(update, score)
        digest.update(encode(update))

    return on_update


def plot_path(path: Path, given: Input, *, several: bool) -> Path:
    """Return the path of the plot of an input: `path`, with the name of the input if there are several."""
    if not several:
        return path
    seed = "" if given.seed is None else f"-{given.seed}"
    name = Path(given.name.replace(":", "-")).stem
    return path.with_name(f"{path.stem}-{name}{seed}{path.suffix}")


def by_file(results: Sequence[Evaluated]) -> dict[str, dict[str, float]]:
    """Means over the seeds of each file, those of the comparator too, and the `spread` of the mean NMI."""
    rows = {}
    for name in dict.fromkeys(result.name for result in results):
        members = [result for result in results if result.name == name]
        nmi = [member.run.summary.mean_nmi for member in members]
        spread = float(np.std(nmi)) if len(nmi) > 1 else math.nan
        rows[name] = means([member.values() | member.compared for member in members]) | {_SPREAD: spread}
    return rows


def as_json(results: Sequence[Evaluated], config: FusionConfig, period: float | None) -> dict[str, Any]:
    """Values for JSON: parameters, one entry per run, and the mean over files."""
    runs = []
    for r in results:
        row = {"file": r.name, "seed": r.seed, "seconds": float(r.run.seconds[-1]), **r.values()}
        row |= {"updates_sha256": r.digest, "joints": plain(r.run.last.joints, without_none=True)}
        runs.append(row | ({"brox_malik": r.compared} if r.compared else {}))
    overall = means(list(by_file(results).values()))
    values: dict[str, Any] = plain(
        {
            "config": config.model_dump(mode="json"),
            "period": config.period if period is None else period,
            "runs": runs,
            "overall": {name: overall[name] for name in results[0].values()},
        }
    )
    return values


def table(results: Sequence[Evaluated], *, everything: bool = False) -> Table:
    """Build a table with one row per file or scene (mean over seeds), and one for all.

    Not wider than 80 characters unless `everything` is asked for, or a comparator was scored.
    """
    rows, comparators = by_file(results), list(results[0].compared) if results else []
    seeded = len(rows) < len(results)
    keys = {column.key for column in _COLUMNS} - (set() if everything else _SELDOM)
    keys -= set() if seeded else {_SPREAD}
    shown = [column for column in _COLUMNS if column.key in keys]
    shown += [Column(name, f"Brox-Malik, {name}", 3) for name in comparators]
    drawn = Table(["file", *(column.title for column in shown)])
    for name, row in rows.items():
        drawn.add(_label(name, 28 if everything else 16), *(column.of(row) for column in shown))
    if len(rows) > 1:
        drawn.end_section()
        row = means(list(rows.values())) | {_SPREAD: math.nan}
        drawn.add("overall", *(column.of(row) for column in shown), strong=True)
    return drawn


_SPREAD = "spread"
_COLUMNS = (
    Column("mean_nmi", "mean NMI", 3),
    Column(_SPREAD, "± seeds", 3),
    Column("final_nmi", "final NMI", 3),
    Column("mean_misclassification", "error %", 1, 100.0),
    Column("mean_hypotheses", "K found", 2),
    Column("mean_objects", "K true", 2),
    Column("switches_per_100", "switches/100", 2),
    Column("hota", "HOTA", 3),
    Column("idf1", "IDF1", 3),
    Column("id_switches", "ID switches", 1),
    Column("ms_per_update", "ms/update", 1),
)
_SELDOM = {"final_nmi", "switches_per_100", "idf1", "id_switches"}


def _label(name: str, width: int) -> str:
    short = name if name.startswith("sim:") else Path(name).name
    return short if len(short) <= width else "…" + short[1 - width :]
