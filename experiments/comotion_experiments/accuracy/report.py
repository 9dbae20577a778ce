"""The accuracy report as Markdown and as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from ..plot import new_figure
from ..tables import Table, document, mean, spread
from .experiment import DEFAULT, ROBUST_SCENES, THESIS, Results

# Scenes in which the truth separates bodies that have not moved yet, so no method can.
_UNKNOWABLE = ("fig4_3", "fig3_3", "3d_late", "3d_static")
_GROUPS = ("thesis scenes", "3-D set", "two sources", "recordings")


def markdown(results: Results, picture: str) -> str:
    """Format the report; `picture` is the path of the reliability diagram."""
    seeds = ", ".join(map(str, results.seeds))
    parts: list[str | Table] = [_HEAD.format(seeds=seeds)]
    scored = "scores" in results.parts
    for group in _GROUPS if scored else ():
        if any(case.group == group for case in results.cases):
            parts += [f"## {group[0].upper()}{group[1:]}", _table(results, group)]
    parts += [*_compared(results), *_motion(results)]
    parts += _reliability(results, picture) if scored else []
    return document([*parts, *_robustness(results)])


_HEAD = """# Accuracy

Made by `comotion dev reproduce accuracy`. NMI (4.1) over every track observed at an update, with an update
each third of a second, beginning with the first third. Undetermined tracks count as clusters of their own.
Mean ± standard deviation over seeds {seeds}. The default method has one parameter set, and does not know the
number of bodies or the noise. The thesis method has equal weights and its best σ_switch: 0.02 m for fig. 4.1,
else 0.01 m. Switches: tracks per 100 whose hypothesis differs from that of the previous update. In fig. 4.3
and 3.3 and with the late mover (3d_late) the truth separates bodies that have not moved yet, so NMI cannot
reach 1.

The methods are described [here](../method.md). The recordings are those on which the default was developed;
[27 others](unseen.md) came after."""


def as_json(results: Results) -> Any:
    """Values for JSON: mean NMI of each case by method and seed, and the other parts that were run."""
    scores: dict[str, dict[str, list[float]]] = {}
    for row in results.rows:
        scores.setdefault(row["case"], {}).setdefault(row["method"], []).append(row["nmi"])
    return {
        "seeds": results.seeds,
        "nmi": scores,
        "comparator": results.compared,
        "motion": results.motion or None,
        "parameters": results.variations,
    }


def _table(results: Results, group: str) -> Table:
    table = Table(["", "default", "t ≥ 1 s", "switches", "thesis", "switches"])
    names = results.names(group)
    for name in names:
        ours = (spread(results.of(name, DEFAULT, figure)) for figure in ("nmi", "late"))
        switches = (f"{np.mean(results.of(name, method, 'switches')):.2f}" for method in (DEFAULT, THESIS))
        table.add(name, *ours, next(switches), spread(results.of(name, THESIS, "nmi")), next(switches))
    if group == "recordings":
        ours, theirs = (np.mean([results.of(n, m, "nmi") for n in names]) for m in (DEFAULT, THESIS))
        table.add("**mean**", f"**{ours:.3f}**", "", "", f"{theirs:.3f}", "")
    return table


_COMPARED = """## The affinity of Brox and Malik

The [affinity of Brox and Malik](https://doi.org/10.1007/978-3-642-15555-0_21) (2010): the largest
difference of motion over the common time, weighted by the distance; here over five frames at 15 Hz
within the window of 10 s. Spectral clustering is given the true number of objects; divisive k-means is
that of the thesis. Mean NMI over the whole seconds of a run, for all methods on the same tracks at the
same times; one that is too short for a motion over five frames counts as undetermined. The affinity is
made for pixels: in metres, lengths are scaled to a width of the scene that was chosen in its favour.

`comotion dev reproduce accuracy --part comparator` makes this table alone."""


def _compared(results: Results) -> list[str | Table]:
    """The comparator, mean over the cases of a group, beside both methods at the same times."""
    if not results.compared:
        return []
    groups = {case.name: case.group for case in results.cases}
    rows = {}
    for name, compared in results.compared.items():
        ours = [results.of(name, method, "whole") for method in (DEFAULT, THESIS)]
        rows[name] = [float(np.mean(cell)) for cell in (*ours, *compared.values())]
    table = Table(("", "default", "thesis", *next(iter(results.compared.values()))))
    for group in dict.fromkeys(groups[name] for name in rows):
        some = [row for name, row in rows.items() if groups[name] == group]
        table.add(f"{group} ({len(some)})", *(f"{score:.3f}" for score in np.mean(some, 0)))
    table.add("**mean**", *(f"{score:.3f}" for score in np.mean(list(rows.values()), 0)))
    better = ", ".join(
        f"{name} ({max(row[2:]):.3f} against {row[0]:.3f})"
        for name, row in rows.items()
        if max(row[2:]) > row[0]
    )
    return [_COMPARED, table, f"Better than the default: {better or 'nowhere'}."]


_POSES = """## Pose since birth and twist

Bodies of 10 features at 5 mm in a box of 0.3 m, 15 Hz; medians over updates, bodies and seeds."""


def _motion(results: Results) -> list[str | Table]:
    if "motion" not in results.parts:
        return []
    return [_POSES, Table(("error", "median"), rows=[(k, f"{v:.2f}") for k, v in results.motion.items()])]


def bins(results: Results) -> list[tuple[float, float, int]]:
    """Mean confidence, share of right assignments and count of each bin that is not empty.

    Of all simulated assignments with known truth.
    """
    names = [name for group in _GROUPS[:2] for name in results.names(group) if name not in _UNKNOWABLE]
    sums = sum(bins for name in names for bins in results.of(name, DEFAULT, "bins"))
    return [(sure / n, right / n, int(n)) for sure, right, n in np.reshape(sums, (-1, 3)).tolist() if n]


_CONFIDENCE = """## Confidence

How often an assignment of a given confidence is right, on the simulated scenes without those whose
bodies rest before they move, because bodies at rest cannot be distinguished."""


def _reliability(results: Results, picture: str) -> list[str | Table]:
    table = Table(("confidence", "right", "assignments"), words=0)
    for confidence, right, count in bins(results):
        table.add(f"{confidence:.3f}", f"{right:.3f}", f"{count}")
    return [_CONFIDENCE, f"![reliability]({picture})", table]


_ROBUSTNESS = """## Robustness

Mean NMI over {scenes} (first seed) and the first 10 s of the recordings,
each parameter of the method halved and doubled; as they are {as_it_is:.3f}."""


def _robustness(results: Results) -> list[str | Table]:
    if not results.variations:
        return []
    base, *scaled = results.variations
    table = Table(("parameter", "halved", "doubled"))
    for halved, doubled in zip(scaled[::2], scaled[1::2], strict=True):
        table.add(halved["parameter"], *(f"{mean(v['scores'].values()):.3f}" for v in (halved, doubled)))
    as_it_is = mean(base["scores"].values())
    text = _ROBUSTNESS.format(scenes=", ".join(ROBUST_SCENES), as_it_is=as_it_is)
    return [text, table, _leave_one_out(results)]


_LEFT_OUT = """Where the setting of this table with the best mean on all other recordings is chosen for each
recording, it scores {there:.3f} there on average, as it is {as_it_is:.3f}."""


def _leave_one_out(results: Results) -> str:
    """Cross-validation: choose the setting on the other recordings, score it on the one left out."""
    names = results.names("recordings")
    if len(names) < 2:
        return ""
    scores = np.array([[v["scores"][name] for name in names] for v in results.variations])
    chosen = [int(np.delete(scores, k, axis=1).mean(axis=1).argmax()) for k in range(len(names))]
    there = scores[chosen, np.arange(len(names))].mean()
    return _LEFT_OUT.format(there=there, as_it_is=scores[0].mean())


def save_reliability(path: Path, results: Results) -> None:
    """Draw the reliability diagram."""
    shares = np.array(bins(results))
    figure = new_figure(5, 4.5)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="#999999", linewidth=1)
    axes.plot(shares[:, 0], shares[:, 1], marker="o", color="#0072b2")
    for x, y, n in shares:
        axes.annotate(f"{int(n)}", (x, y), textcoords="offset points", xytext=(5, -10), fontsize=7)
    axes.set(xlabel="confidence", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02))
    figure.savefig(path)
