"""Ablation: each rule of the default method in metric spaces left out alone, and what that costs."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import numpy as np

from comotion import FusionConfig
from comotion.rigid.kernels.resampling import resample
from comotion_clients.watch_columns import number
from comotion_schemas.errors import KnownError

from .accuracy import RECORDINGS, Case, run_case
from .stress.study import Family, run_family
from .study import Row, values
from .tables import Table, document, mean

WHOLE = "whole"
"""Stands for the method with all its rules."""
SCATTER = 0.003
"""NMI; changes below it are those of chance."""
_SHOWN = 2


@dataclass(frozen=True)
class Rule:
    """A rule, term or group of constants, in words, and what stands in its place."""

    what: str
    # By "module.attribute", within ``comotion.rigid``. No constants of kernels, which are compiled in.
    changes: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the group `rigid`

    @contextmanager
    def left_out(self) -> Iterator[FusionConfig]:
        """Leave the rule out in this process for as long as the context lasts; yields the parameters."""
        with ExitStack() as stack:
            for path, value in self.changes.items():
                stack.enter_context(patch(f"comotion.rigid.{path}", value))
            yield FusionConfig.model_validate({"rigid": dict(self.parameters)})


def _only_white(_tracks: Any, _y: Any, _w: Any, owner: Any, tolerance: Any, *_: Any) -> Any:
    return tolerance, np.tile([1.0, 0.0, 0.0], (len(owner), 1))


def _no_costs(scene: Any, fitted: Any, *_: Any) -> Any:
    return np.zeros((len(scene.hypotheses), len(fitted)))


def _with_errors(observations: Any, stamps: Any, limits: Any, variance: Any, *out: Any) -> None:
    resample(observations, stamps, limits, np.full_like(variance, np.inf), *out)


RULES: dict[str, Rule] = {
    "gross": Rule("gross errors are left out", {"resampling.resample": _with_errors}),
    "contact": Rule("slack of what rests and is touched", {"resampling._OF_CONTACT": 0.0}),
    "past_evidence": Rule("price of leaving a separate hypothesis", {"selection.past_evidence": _no_costs}),
    "clear_members": Rule("price of leaving for clear members", {"search.carried_costs": _no_costs}),
    "membership": Rule("price of memberships", {"selection._MEMBERSHIP": 0.0}),
    "slow_noise": Rule("slow noise", {"resampling._with_slow_noise": _only_white}),
    "looseness": Rule("deformation of bodies", parameters={"looseness": 0.0}),
    "contradiction": Rule("nats that speak against a body", {"belief._CONTRARY": 0.0}),
    "uncovered": Rule("more than an outlier where a body has no pose", {"costs._UNCOVERED_SHARE": 0.5}),
    "place": Rule("spatial prior", {"assignment._MOST_PLACE": 0.0}),
    "sliding": Rule(
        "features that slide",
        {"fits.with_sliders": lambda _f, _b, body, *_: (body, np.zeros(body.shape, np.bool_))},
    ),
    "arrivals": Rule("newborn amid newborn wait", {"search.undecided": lambda _scene, labels: labels}),
    "settled": Rule("one pose for each rest", {"fits.settled": lambda _frames, body: body}),
}
"""By name."""


def rule_of(name: str) -> Rule:
    """A rule by its name, or ``PARAMETER=VALUE`` for a parameter of the group `rigid`.

    Raises
    ------
    ValueError
        If there is no such rule, parameter or value.
    """
    parameter, sign, value = name.partition("=")
    if not sign and name not in RULES:
        raise KnownError(f"no rule {name!r}; one of {', '.join(RULES)}, or PARAMETER=VALUE")
    rule = Rule(f"{parameter} {value}", parameters={parameter: value}) if sign else RULES[name]
    with rule.left_out():
        return rule


def run_without(case: Family | Case, rule: str, seed: int) -> Row:
    """Run a family or recording without a rule, or :data:`WHOLE`."""
    with (Rule("nothing") if rule == WHOLE else rule_of(rule)).left_out() as config:
        if isinstance(case, Family):
            return {"nmi": run_family(case.name, seed, config)["nmi_apart"]}
        return {"nmi": run_case(case, config, seed)["nmi"]}


_HEAD = """# Ablation

Made by `comotion dev reproduce ablation`. Each rule of the default method is left out alone; mean NMI
over all updates. Stress families with seeds {seeds}, and recordings.
The last column names the two scenes that change most, by more than {scatter:.3f}."""


def markdown(rows: Sequence[Row]) -> str:
    """A table with a line for each rule."""
    table = Table(("left out", "families", "recordings", "changes"))
    whole = _means(rows, WHOLE)
    for rule in dict.fromkeys(row["setting"] for row in rows):
        nmi = _means(rows, rule)
        changes = {case: nmi[case] - whole[case] for case in nmi}
        largest = sorted(changes.items(), key=lambda item: -abs(item[1]))[:_SHOWN]
        changed = ", ".join(f"{name} {change:+.3f}" for (_, name), change in largest if abs(change) > SCATTER)
        of_kinds = (mean(v for (recorded, _), v in nmi.items() if recorded == kind) for kind in (False, True))
        title = "nothing" if rule == WHOLE else f"`{rule}`: {rule_of(rule).what}"
        table.add(title, *(number(value, 4) for value in of_kinds), changed or "-")
    seeds = sorted({row["seed"] for row in rows if row["group"] != RECORDINGS})
    return document([_HEAD.format(seeds=", ".join(map(str, seeds)), scatter=SCATTER), table])


def _means(rows: Sequence[Row], rule: str) -> dict[tuple[bool, str], float]:
    """Mean NMI without a rule, by whether it is a recording, and the name of the case; sorted."""
    cases = {(row["group"] == RECORDINGS, row["case"]) for row in rows}
    return {case: mean(values(rows, "nmi", setting=rule, case=case[1])) for case in sorted(cases)}
