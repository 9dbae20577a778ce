"""The accuracy report as Markdown and as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from ..plot import new_figure
from ..tables import Table, spread
from .experiment import DEFAULT, ROBUST_SCENES, THESIS, Results
from .study import PERIOD, Array, Outcome

_BINS = np.array([0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9])
# Scenes in which the truth separates bodies that have not moved yet, so no method can.
_UNKNOWABLE = ("fig4_3", "fig3_3", "3d_late", "3d_static")
_GROUPS = ("thesis scenes", "3-D set", "two sources", "recordings")


def markdown(results: Results, picture: str) -> str:
    """Format the report; `picture` is the path of the reliability diagram."""
    present = {case.group for case in results.experiment.cases}
    scored = "scores" in results.experiment.parts
    seeds = ", ".join(map(str, results.experiment.seeds))
    parts = [_HEAD.format(seeds=seeds)]
    if scored:
        parts += [_table(results, group) for group in _GROUPS if group in present]
    parts += [_compared(results), _motion(results)]
    parts += [_reliability(results, picture)] if scored else []
    parts += [_robustness(results)]
    return "\n\n".join(part for part in parts if part) + "\n"


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
    for (name, method), outcomes in results.outcomes.items():
        scores.setdefault(name, {})[method] = [o.mean for o in outcomes]
    moved = "motion" in results.experiment.parts
    return {
        "seeds": results.experiment.seeds,
        "nmi": scores,
        "comparator": results.compared,
        "motion": results.motion.medians() if moved else None,
        "parameters": results.variations,
    }


def _table(results: Results, group: str) -> str:
    table = Table(["", "default", "t ≥ 1 s", "switches", "thesis", "switches"])
    names = [case.name for case in results.experiment.cases if case.group == group]
    for name in names:
        table.add(*_row(results, name))
    if group == "recordings":
        table.add(*_means(results, names))
    return f"## {group[0].upper()}{group[1:]}\n\n{table.markdown()}"


def _row(results: Results, name: str) -> list[str]:
    ours, thesis = (results.outcomes[name, m] for m in (DEFAULT, THESIS))
    return [
        name,
        spread([o.mean for o in ours]),
        spread([_late(o) for o in ours]),
        f"{np.mean([o.switches for o in ours]):.2f}",
        spread([o.mean for o in thesis]),
        f"{np.mean([o.switches for o in thesis]):.2f}",
    ]


def _means(results: Results, names: list[str]) -> list[str]:
    ours, thesis = (
        f"{np.mean([results.outcomes[n, m][0].mean for n in names]):.3f}" for m in (DEFAULT, THESIS)
    )
    return ["**mean**", f"**{ours}**", "", "", thesis, ""]


def _late(outcome: Outcome) -> float:
    return float(np.nanmean(outcome.nmi[outcome.seconds >= 0.99]))


_COMPARED = """## The affinity of Brox and Malik

The [affinity of Brox and Malik](https://doi.org/10.1007/978-3-642-15555-0_21) (2010): the largest
difference of motion over the common time, weighted by the distance; here over five frames at 15 Hz
within the window of 10 s. Spectral clustering is given the true number of objects; divisive k-means is
that of the thesis. Mean NMI over the whole seconds of a run, for all methods on the same tracks at the
same times; one that is too short for a motion over five frames counts as undetermined. The affinity is
made for pixels: in metres, lengths are scaled to a width of the scene that was chosen in its favour.

`comotion dev reproduce accuracy --part comparator` makes this table alone."""


def _compared(results: Results) -> str:
    """The comparator, mean over the cases of a group, beside both methods at the same times."""
    if not results.compared:
        return ""
    clusterings = list(next(iter(results.compared.values())))
    groups = {case.name: case.group for case in results.experiment.cases}
    rows = {name: _compared_means(results, name) for name in results.compared}
    table = Table(("", "default", "thesis", *clusterings))
    for group in dict.fromkeys(groups[name] for name in rows):
        some = [row for name, row in rows.items() if groups[name] == group]
        table.add(f"{group} ({len(some)})", *(f"{score:.3f}" for score in np.mean(some, 0)))
    table.add("**mean**", *(f"{score:.3f}" for score in np.mean(list(rows.values()), 0)))
    better = ", ".join(
        f"{name} ({max(row[2:]):.3f} against {row[0]:.3f})"
        for name, row in rows.items()
        if max(row[2:]) > row[0]
    )
    return f"{_COMPARED}\n\n{table.markdown()}\n\nBetter than the default: {better or 'nowhere'}."


def _compared_means(results: Results, name: str) -> list[float]:
    """Mean over seeds of the default, the thesis method and each clustering."""
    ours = [np.mean([_whole(o) for o in results.outcomes[name, method]]) for method in (DEFAULT, THESIS)]
    return [*map(float, ours), *(float(np.mean(cell)) for cell in results.compared[name].values())]


def _whole(outcome: Outcome) -> float:
    """Mean NMI over the updates at whole seconds."""
    off = np.abs(outcome.seconds - np.round(outcome.seconds))
    return float(np.nanmean(outcome.nmi[(off < PERIOD / 2) & (outcome.seconds > PERIOD)]))


_POSES = """## Pose since birth and twist

Bodies of 10 features at 5 mm in a box of 0.3 m, 15 Hz; medians over updates, bodies and seeds."""


def _motion(results: Results) -> str:
    if "motion" not in results.experiment.parts:
        return ""
    medians = results.motion.medians().items()
    table = Table(("error", "median"), rows=[(name, f"{value:.2f}") for name, value in medians])
    return f"{_POSES}\n\n{table.markdown()}"


def pooled(results: Results) -> tuple[Array, Array]:
    """Confidence and correctness (0 or 1) of all simulated assignments with known truth, [n] each."""
    chosen = [
        outcome
        for case in results.experiment.cases
        if case.group in _GROUPS[:2] and case.name not in _UNKNOWABLE
        for outcome in results.outcomes[case.name, DEFAULT]
    ]
    confidence = np.concatenate([np.zeros(0), *(o.confidence for o in chosen)])
    return confidence, np.concatenate([np.zeros(0), *(o.right.astype(np.float64) for o in chosen)])


def bins(results: Results) -> list[tuple[float, float, int]]:
    """Mean confidence, share of right assignments and count of each bin that is not empty."""
    confidence, right = pooled(results)
    place = np.digitize(confidence, _BINS) - 1
    return [
        (float(confidence[place == k].mean()), float(right[place == k].mean()), int((place == k).sum()))
        for k in range(len(_BINS) - 1)
        if (place == k).any()
    ]


_CONFIDENCE = """## Confidence

How often an assignment of a given confidence is right, on the simulated scenes without those whose
bodies rest before they move, because bodies at rest cannot be distinguished."""


def _reliability(results: Results, picture: str) -> str:
    table = Table(("confidence", "right", "assignments"), words=0)
    for confidence, right, count in bins(results):
        table.add(f"{confidence:.3f}", f"{right:.3f}", f"{count}")
    return f"{_CONFIDENCE}\n\n![reliability]({picture})\n\n{table.markdown()}"


_ROBUSTNESS = """## Robustness

Mean NMI over {scenes} (first seed) and the first 10 s of the recordings,
each parameter of the method halved and doubled; as they are {as_it_is:.3f}."""


def _robustness(results: Results) -> str:
    if not results.variations:
        return ""
    base, *scaled = results.variations
    halved = {v.parameter: v.mean for v in scaled if v.factor < 1}
    doubled = {v.parameter: v.mean for v in scaled if v.factor > 1}
    table = Table(("parameter", "halved", "doubled"))
    for name, value in halved.items():
        table.add(name, f"{value:.3f}", f"{doubled[name]:.3f}")
    text = _ROBUSTNESS.format(scenes=", ".join(ROBUST_SCENES), as_it_is=base.mean)
    return f"{text}\n\n{table.markdown()}{_leave_one_out(results)}"


_LEFT_OUT = """Where the setting of this table with the best mean on all other recordings is chosen for each
recording, it scores {there:.3f} there on average, as it is {as_it_is:.3f}."""


def _leave_one_out(results: Results) -> str:
    """Cross-validation: choose the setting on the other recordings, score it on the one left out."""
    names = [c.name for c in results.experiment.cases if c.group == "recordings"]
    if len(names) < 2:
        return ""
    scores = np.array([[v.scores[name] for name in names] for v in results.variations])
    chosen = [int(np.delete(scores, k, axis=1).mean(axis=1).argmax()) for k in range(len(names))]
    there = scores[chosen, np.arange(len(names))].mean()
    return f"\n\n{_LEFT_OUT.format(there=there, as_it_is=scores[0].mean())}"


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
