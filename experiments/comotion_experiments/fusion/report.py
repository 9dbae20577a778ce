"""The fusion experiment as a table, as a page, as JSON and as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from ..plot import new_figure
from ..tables import Table, plain, spread
from .experiment import AFTER_S, Case, Results, verdict
from .setup import ALL, ALONE_A, ALONE_B, WITH_ROBOT
from .study import Outcome

_COLOURS = {ALONE_A.name: "#999999", WITH_ROBOT.name: "#e69f00", ALL.name: "#0072b2"}


_NAMES = ("scene", "camera A", "sources")
_NUMBERS = ("NMI of A", f"{AFTER_S:.0f} s after", "NMI of all", "surface %", "ids kept %")


def table(results: Results) -> Table:
    """One row per scene, cover and variant: means and, after ±, the spread over seeds."""
    found = Table((*_NAMES, *_NUMBERS), words=len(_NAMES))
    for scene in results.scenes:
        for case in (c for c in results.cases if c.scene == scene):
            found.add(*_cells(case, results))
        found.end_section()
    return found


def _cells(case: Case, results: Results) -> tuple[str, ...]:
    start, stop = results.setup.cover
    after = case.nmi_a(stop, stop + AFTER_S) if case.covered else np.array([np.nan])
    kept = case.kept((start, stop)) if case.covered else np.array([np.nan])
    return (
        case.scene,
        "covered" if case.covered else "-" if case.variant is ALONE_B else "open",
        case.variant.name,
        spread(case.nmi_a()),
        spread(after),
        spread(case.nmi()),
        spread(100 * case.surface(), 1),
        spread(100 * kept, 0),
    )


def lines(results: Results) -> list[str]:
    """What the experiment says, in words and numbers."""
    v = verdict(results)
    return [
        f"On camera A's features, fusing all against A alone: {v.gain:+.4f} NMI on average, "
        f"{v.worst_gain:+.4f} in the worst scene, {v.worst_seed:+.4f} in the worst seed; "
        f"{v.gain_after:+.4f} in the {AFTER_S:.0f} s after A was covered.",
        "Hypothesis ids that stay while A is covered, of objects that B sees or the robot carries: "
        f"{100 * v.kept:.0f} %.",
        f"On all features, fused: {100 * v.surface:.1f} % of the objects' surface at NMI {v.nmi:.3f}; "
        f"best single camera of each scene: {100 * v.surface_single:.1f} % at {v.nmi_single:.3f}.",
    ]


_PAGE = """# Fusing sources

Made by `comotion dev reproduce fusion`, method {method}, on the [workcell](../workcell.md): camera A at
{rate_a:g} Hz, camera B at {rate_b:g} Hz ({width} x {height} px, {features} features each), a robot's joints
at {rate_robot:g} Hz; seeds {seeds}, mean ± standard deviation. Covered: the lens of camera A is covered from
{start:g} to {stop:g} s.

- NMI of A: over the features of camera A alone, so that all sources are compared on the same
  features; also in the {after:.0f} s after the lens is free again. NMI of all: over the features of all
  sources.
- Surface: share of the surface of moving objects that is within 3 cm of one of their features.
- Ids kept: while A is covered, share of objects and updates whose hypothesis keeps its id, among the
  objects that B sees or the robot carries.

NMI cannot reach 1 here: the truth separates objects that have not moved yet.

{lines}

![NMI over time]({picture})

{table}
"""


def markdown(results: Results, picture: str) -> str:
    """The whole report; `picture` is the path of the plot from there."""
    setup = results.setup
    return _PAGE.format(
        method=results.method,
        rate_a=setup.rate_a,
        rate_b=setup.rate_b,
        rate_robot=setup.rate_robot,
        width=setup.size[0],
        height=setup.size[1],
        features=setup.features,
        seeds=", ".join(str(seed) for seed in results.seeds),
        start=setup.cover[0],
        stop=setup.cover[1],
        after=AFTER_S,
        lines="\n".join(f"- {line}" for line in lines(results)),
        picture=picture,
        table=table(results).markdown(),
    )


def as_json(results: Results) -> Any:
    """Everything as plain values, one entry per scene, cover and variant."""
    start, stop = results.setup.cover
    cases = [
        {
            "scene": case.scene,
            "covered": case.covered,
            "sources": case.variant.sources,
            "nmi_a": case.nmi_a(),
            "nmi_a_after": case.nmi_a(stop, stop + AFTER_S),
            "nmi": case.nmi(),
            "surface": case.surface(),
            "ids_kept": case.kept((start, stop)),
        }
        for case in results.cases
    ]
    about = {"method": results.method, "seeds": results.seeds, "setup": results.setup}
    return plain({**about, "cases": cases, "verdict": verdict(results)})


def save_picture(path: Path, results: Results) -> None:
    """Draw NMI over time on camera A's features, a row per scene, A open on the left and covered right.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    """
    scenes = results.scenes
    figure = new_figure(12, 1.2 + 2.4 * len(scenes))
    axes = figure.subplots(len(scenes), 2, sharex=True, sharey=True, squeeze=False)
    for row, scene in zip(axes, scenes, strict=True):
        for covered, axis in enumerate(row):
            _draw(axis, results, scene, covered=bool(covered))
    axes[0, 0].set_title("camera A open")
    axes[0, 1].set_title("camera A covered for a while")
    axes[0, 0].legend(loc="lower right", fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("s")
    seeds = f"{len(results.seeds)} seeds" if len(results.seeds) > 1 else "1 seed"
    figure.suptitle(f"NMI over camera A's features (mean and spread of {seeds}), method {results.method}")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _draw(axis: Any, results: Results, scene: str, *, covered: bool) -> None:
    for variant in (ALONE_A, WITH_ROBOT, ALL):
        outcomes = results.case(scene, covered=covered, variant=variant).outcomes
        t, mean, spread = _curve(outcomes)
        axis.plot(t, mean, color=_COLOURS[variant.name], label=variant.name, linewidth=1.8)
        axis.fill_between(
            t, mean - spread, mean + spread, color=_COLOURS[variant.name], alpha=0.2, linewidth=0
        )
    if covered:
        axis.axvspan(*results.setup.cover, color="black", alpha=0.12, linewidth=0)
    axis.set_ylim(0, 1.02)
    axis.set_ylabel(scene)
    axis.grid(alpha=0.3)


def _curve(outcomes: list[Outcome]) -> tuple[np.ndarray, Any, Any]:
    """Times, mean and spread over seeds; masked where no seed has a value, so that lines break there."""
    t = outcomes[0].t
    values = np.ma.masked_invalid([np.interp(t, o.t, o.nmi_a) for o in outcomes])
    return t, values.mean(axis=0), values.std(axis=0)
