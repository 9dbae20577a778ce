"""Numbers that several figures report."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from comotion_schemas import UNDETERMINED
from comotion_sources.simulator import load_scene

from ..tables import spread
from ..trace import rightly_assigned
from .runs import SceneRuns
from .study import DEFAULT, Row, Simulated, Study


def count(values: Any) -> str:
    """Mean and, where seeds differ, standard deviation of one number per seed."""
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if len(finite) and finite.std() > 0:
        return f"{finite.mean():.1f} ± {finite.std():.1f}"
    return f"{finite.mean():g}" if len(finite) else "-"


def row_of(
    quantity: str, printed: str, takes: Mapping[str, SceneRuns], value: Callable[[SceneRuns], str]
) -> Row:
    """What the thesis says of a quantity, and its value for the thesis method and for the default one."""
    thesis, default = (value(take) for take in takes.values())
    return Row(quantity, printed, thesis, default)


def count_at(take: SceneRuns, t: float) -> str:
    """Number of hypotheses at the update nearest to a time."""
    return count(take.hypotheses_at(t))


def right_rows(takes: Mapping[str, SceneRuns], times: Sequence[float], printed: str) -> list[Row]:
    """Features with the hypothesis of their object in each view."""
    what = "features in the right hypothesis at t ="
    return [
        row_of(f"{what} {t:.3g} s", printed, takes, partial(_right_at, view=k)) for k, t in enumerate(times)
    ]


def _right_at(take: SceneRuns, view: int) -> str:
    """Share of features with the hypothesis of their object, in one view of every seed."""
    shares = []
    for seed in take.seeds:
        moment = seed.views[view].moment
        scored = (moment.objects >= 0) & (moment.hypotheses != UNDETERMINED)
        right = rightly_assigned(moment.hypotheses[scored], moment.objects[scored]).sum()
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


def best(takes: Mapping[str, SceneRuns]) -> str:
    """Label of the thesis parameters with the best mean NMI."""
    return max((label for label in takes if label != DEFAULT), key=lambda k: takes[k].mean_nmi().mean())


def summary(takes: Mapping[str, SceneRuns]) -> tuple[str, str]:
    """Mean NMI of the thesis method at its best, and of the default method."""
    label = best(takes)
    return f"{spread(takes[label].mean_nmi())} ({label})", spread(takes[DEFAULT].mean_nmi())


def rows_of_each(
    quantity: str,
    takes: Mapping[str, SceneRuns],
    said: Iterable[str],
    value: Callable[[SceneRuns], str] = lambda take: spread(take.mean_nmi()),
) -> list[Row]:
    """A value of each take, with what the thesis says of each; the default method last."""
    *tried, default = map(value, takes.values())
    columns = zip(takes, said, tried, strict=False)
    rows = [Row(f"{label}: {quantity}", text, shown, "") for label, text, shown in columns]
    return [*rows, Row(quantity, "-", "", default)]


def parameters(how: Simulated, study: Study, thesis: str = "", *, drawn: bool = True) -> dict[str, str]:
    """What a figure of a simulated scene was made with; `drawn`: it shows one seed of these."""
    scene = {"scene": f"sim:{how.scene}, {load_scene(how.scene).rate:g} Hz"}
    thesis = thesis or next(iter(how.configs)).removeprefix("thesis method, ")
    return scene | run_parameters(thesis, how.period, study.options.seeds, drawn=drawn)


def run_parameters(thesis: str, period: float, seeds: Sequence[int], *, drawn: bool) -> dict[str, str]:
    """How a scene was run: parameters of the thesis method, s between updates, seeds."""
    named = ", ".join(map(str, seeds))
    made_with = {"thesis method": thesis, "update every": f"{period:.3g} s", "seeds": named}
    return made_with | ({"drawn": f"seed {seeds[0]}"} if drawn else {})
