"""The accuracy report as Markdown and as a picture."""

import statistics
from pathlib import Path

import numpy as np

from .experiment import DEFAULT, REFERENCE, ROBUST_SCENES, THESIS, Results
from .study import PERIOD, Array, Outcome

_BINS = np.array([0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9])
# Scenes in which the truth separates bodies that have not moved yet, so no method can.
_UNKNOWABLE = ("fig4_3", "fig3_3", "3d_late", "3d_static")
_GROUPS = ("thesis scenes", "3-D set", "two sources", "recordings")


def markdown(results: Results, picture: str) -> str:
    """Format the report; `picture` is the path of the reliability diagram."""
    present = {case.group for case in results.experiment.cases}
    scored = "scores" in results.experiment.parts
    parts = [_head(results)]
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
else 0.01 m. `by scikit-learn` is the thesis method with clusters split by scikit-learn's 2-means, the best of
ten random starts. Switches: tracks per 100 whose hypothesis differs from that of the previous update. In
fig. 4.3 and 3.3 and with the late mover (3d_late) the truth separates bodies that have not moved yet, so NMI
cannot reach 1.

The methods are described [here](../method.md). The recordings are those on which the default was developed;
[27 others](unseen.md) came after."""


def _head(results: Results) -> str:
    return _HEAD.format(seeds=", ".join(str(s) for s in results.experiment.seeds))


def _table(results: Results, group: str) -> str:
    recorded = group == "recordings"
    head = "| | default | t ≥ 1 s | switches | thesis | switches | by scikit-learn |"
    lines = [f"## {group[0].upper()}{group[1:]}", "", head + (" linkage 5 mm |" if recorded else "")]
    lines.append("|" + "---|" * (8 if recorded else 7))
    names = [case.name for case in results.experiment.cases if case.group == group]
    lines += [_row(results, name, recorded=recorded) for name in names]
    if recorded:
        lines.append(_means(results, group))
    return "\n".join(lines)


def _row(results: Results, name: str, *, recorded: bool) -> str:
    ours, thesis = results.outcomes[name, DEFAULT], results.outcomes[name, THESIS]
    cells = [
        name,
        _spread([o.mean for o in ours]),
        _spread([_late(o) for o in ours]),
        f"{np.mean([o.switches for o in ours]):.2f}",
        _spread([o.mean for o in thesis]),
        f"{np.mean([o.switches for o in thesis]):.2f}",
        _spread([o.mean for o in results.outcomes[name, REFERENCE]]),
    ]
    if recorded:
        cells.append(f"{np.nanmean(results.linkage[name]):.3f}")
    return "| " + " | ".join(cells) + " |"


def _means(results: Results, group: str) -> str:
    names = [c.name for c in results.experiment.cases if c.group == group]
    ours, thesis, reference = (
        np.mean([results.outcomes[n, m][0].mean for n in names]) for m in (DEFAULT, THESIS, REFERENCE)
    )
    plain = np.mean([np.nanmean(results.linkage[n]) for n in names])
    return f"| **mean** | **{ours:.3f}** | | | {thesis:.3f} | | {reference:.3f} | {plain:.3f} |"


def _late(outcome: Outcome) -> float:
    return float(np.nanmean(outcome.nmi[outcome.seconds >= 0.99]))


def _spread(values: list[float]) -> str:
    mean = statistics.fmean(values)
    return f"{mean:.3f} ± {statistics.pstdev(values):.3f}" if len(values) > 1 else f"{mean:.3f}"


_COMPARED = """## The affinity of Brox and Malik

The [affinity of Brox and Malik](https://doi.org/10.1007/978-3-642-15555-0_21) (2010): the largest
difference of motion over the common time, weighted by the distance; here over five frames at 15 Hz
within the window of 10 s. Spectral clustering is given the true number of objects; divisive k-means is
that of the thesis. Mean NMI over the whole seconds of a run, for all methods on the same tracks at the
same times; one that is too short for a motion over five frames counts as undetermined. The affinity is
made for pixels: in metres, lengths are scaled to a width of the scene that was chosen in its favour.

`comotion dev reproduce accuracy --part comparator` makes this table alone."""


def _compared(results: Results) -> str:
    """The comparator on every case, mean over seeds, beside both methods at the same times."""
    if not results.compared:
        return ""
    clusterings = list(next(iter(results.compared.values())))
    lines = [_COMPARED, "", "| | default | thesis | " + " | ".join(clusterings) + " |"]
    lines.append("|" + "---|" * (3 + len(clusterings)))
    rows: dict[str, list[list[float]]] = {}
    for name, found in results.compared.items():
        ours = [[_whole(o) for o in results.outcomes[name, method]] for method in (DEFAULT, THESIS)]
        rows[name] = [*ours, *(found[c] for c in clusterings)]
        lines.append(f"| {name} | " + " | ".join(_spread(cell) for cell in rows[name]) + " |")
    means = np.array([[np.mean(cell) for cell in row] for row in rows.values()]).mean(0)
    return "\n".join([*lines, "| **mean** | " + " | ".join(f"{one:.3f}" for one in means) + " |"])


def _whole(outcome: Outcome) -> float:
    """Mean NMI over the updates at whole seconds."""
    off = np.abs(outcome.seconds - np.round(outcome.seconds))
    return float(np.nanmean(outcome.nmi[(off < PERIOD / 2) & (outcome.seconds > PERIOD)]))


def _motion(results: Results) -> str:
    if "motion" not in results.experiment.parts:
        return ""
    lines = [
        "## Pose since birth and twist",
        "",
        "Bodies of 10 features at 5 mm in a box of 0.3 m, 15 Hz; medians over updates, bodies and seeds.",
        "",
        "| error | median |",
        "|---|---|",
    ]
    lines += [f"| {name} | {value:.2f} |" for name, value in results.motion.medians().items()]
    return "\n".join(lines)


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


def _reliability(results: Results, picture: str) -> str:
    lines = [
        "## Confidence",
        "",
        "How often an assignment of a given confidence is right, on the simulated scenes without those whose",
        "bodies rest before they move, because bodies at rest cannot be distinguished.",
        "",
        f"![reliability]({picture})",
        "",
        "| confidence | right | assignments |",
        "|---|---|---|",
    ]
    lines += [f"| {c:.3f} | {r:.3f} | {n} |" for c, r, n in bins(results)]
    return "\n".join(lines)


def _robustness(results: Results) -> str:
    if not results.variations:
        return ""
    base, *scaled = results.variations
    halved = {v.parameter: v.mean for v in scaled if v.factor < 1}
    doubled = {v.parameter: v.mean for v in scaled if v.factor > 1}
    lines = [
        "## Robustness",
        "",
        f"Mean NMI over {', '.join(ROBUST_SCENES)} (first seed) and the first 10 s of the recordings,",
        "each parameter of the method halved and doubled.",
        "",
        "| parameter | halved | as it is | doubled |",
        "|---|---|---|---|",
    ]
    lines += [f"| {k} | {halved[k]:.3f} | {base.mean:.3f} | {doubled[k]:.3f} |" for k in halved]
    return "\n".join(lines) + _leave_one_out(results)


def _leave_one_out(results: Results) -> str:
    """Cross-validation: choose the setting on the other recordings, score it on the one left out."""
    names = [c.name for c in results.experiment.cases if c.group == "recordings"]
    if len(names) < 2:
        return ""
    scores = np.array([[v.scores[name] for name in names] for v in results.variations])
    lines = [
        "",
        "",
        "### Leave one recording out",
        "",
        "For each recording: the setting of the table above with the best mean on the other recordings,",
        "and its score on this one.",
        "",
        "| recording | setting chosen | there | as it is |",
        "|---|---|---|---|",
    ]
    chosen = [int(np.delete(scores, k, axis=1).mean(axis=1).argmax()) for k in range(len(names))]
    for k, name in enumerate(names):
        best = results.variations[chosen[k]]
        setting = f"{best.parameter} x {best.factor:g}" if best.parameter else "as it is"
        lines.append(f"| {name} | {setting} | {scores[chosen[k], k]:.3f} | {scores[0, k]:.3f} |")
    there = scores[chosen, np.arange(len(names))].mean()
    lines.append(f"| **mean** | | **{there:.3f}** | {scores[0].mean():.3f} |")
    return "\n".join(lines)


def save_reliability(path: Path, results: Results) -> None:
    """Draw the reliability diagram."""
    from matplotlib.figure import Figure

    found = np.array(bins(results))
    figure = Figure(figsize=(5, 4.5), dpi=100, layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="#999999", linewidth=1)
    axes.plot(found[:, 0], found[:, 1], marker="o", color="#0072b2")
    for x, y, n in found:
        axes.annotate(f"{int(n)}", (x, y), textcoords="offset points", xytext=(5, -10), fontsize=7)
    axes.set(xlabel="confidence", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02))
    figure.savefig(path)
