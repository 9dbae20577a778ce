"""Numbers that several figures report."""

from typing import Any

import numpy as np

from comotion_schemas import UNDETERMINED

from ..tables import spread
from ..trace import rightly_assigned
from .runs import SceneRuns, View
from .study import Study, describe, spec_of

DEFAULT = "default method"


def count(values: Any) -> str:
    """Mean and, where seeds differ, standard deviation of one number per seed."""
    known = np.asarray(values, np.float64)
    known = known[np.isfinite(known)]
    if len(known) and known.std() > 0:
        return f"{known.mean():.1f} ± {known.std():.1f}"
    return f"{known.mean():g}" if len(known) else "-"


def view_at(take: SceneRuns, t: float, seed: int = 0) -> View:
    """The view of a seed nearest to a time."""
    return min(take.seeds[seed].views, key=lambda view: abs(view.t - t))


def right_at(take: SceneRuns, view: int) -> str:
    """Share of features with the hypothesis of their object, in one view of every seed."""
    shares = []
    for seed in take.seeds:
        moment = seed.views[view].moment
        known = (moment.objects >= 0) & (moment.hypotheses != UNDETERMINED)
        right = rightly_assigned(moment.hypotheses[known], moment.objects[known]).sum()
        shares.append(100 * right / max(int((moment.objects >= 0).sum()), 1))
    return f"{spread(shares, 0)} %"


def perfect_from(take: SceneRuns) -> Any:
    """Time from which on NMI is 1, seconds, per seed; NaN where it never is."""
    times = []
    for seed in take.seeds:
        wrong = np.flatnonzero(~(seed.nmi > 1 - 1e-9))
        first = wrong[-1] + 1 if len(wrong) else 0
        times.append(seed.t[first] if first < len(seed.t) else np.nan)
    return np.array(times)


def format_times(seconds: Any) -> str:
    """Format the times from which on NMI is 1."""
    never = int(np.isnan(seconds).sum())
    if never == len(seconds):
        return "never"
    return f"{spread(seconds, 1)} s" + (f" (never in {never} of {len(seconds)} seeds)" if never else "")


def best(takes: dict[str, SceneRuns]) -> str:
    """Label of the thesis parameters with the best mean NMI."""
    return max((label for label in takes if label != DEFAULT), key=lambda k: takes[k].mean_nmi().mean())


def summary(takes: dict[str, SceneRuns]) -> tuple[str, str]:
    """Mean NMI of the thesis method at its best, and of the default method."""
    label = best(takes)
    return f"{spread(takes[label].mean_nmi())} ({label})", spread(takes[DEFAULT].mean_nmi())


def parameters(scene: str, config: Any, study: Study, period: float) -> dict[str, str]:
    """What a figure of a simulated scene was made with."""
    seeds = study.options.seeds
    return {
        "scene": f"sim:{scene}, {spec_of(scene).rate:g} Hz",
        "thesis method": describe(config).removeprefix("thesis method, "),
        "update every": f"{period:.3g} s",
        "seeds": ", ".join(map(str, seeds)),
        "drawn": f"seed {seeds[0]}",
    }
