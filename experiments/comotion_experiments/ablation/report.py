"""The results of an ablation as Markdown."""

from ..tables import Table, mean, number
from .experiment import SCATTER, WHOLE, Results
from .rules import RULES

_SHOWN = 2
_HEAD = """# Ablation

Made by `comotion dev reproduce ablation`. Each rule of the default method is left out alone; mean NMI
over all updates. Stress families with seeds {seeds}, and recordings.
The last column names the two scenes that change most, by more than {scatter:.3f}."""


def markdown(results: Results) -> str:
    """A table with a line for each rule."""
    drawn = Table(("left out", "families", "recordings", "changes"))
    drawn.add(*_cells(results, WHOLE, "nothing"))
    for name in dict.fromkeys(run.rule for run in results.runs if run.rule != WHOLE):
        drawn.add(*_cells(results, name, f"`{name}`: {RULES[name].what}"))
    seeds = ", ".join(map(str, results.seeds))
    return f"{_HEAD.format(seeds=seeds, scatter=SCATTER)}\n\n{drawn.markdown()}\n"


def _cells(results: Results, rule: str, title: str) -> tuple[str, ...]:
    families, recordings = (results.means(rule, recorded=recorded) for recorded in (False, True))
    whole = results.means(WHOLE, recorded=False) | results.means(WHOLE, recorded=True)
    changes = {name: nmi - whole[name] for name, nmi in (families | recordings).items()}
    largest = sorted(changes.items(), key=lambda item: -abs(item[1]))[:_SHOWN]
    changed = ", ".join(f"{name} {change:+.3f}" for name, change in largest if abs(change) > SCATTER)
    return title, number(mean(families.values()), 4), number(mean(recordings.values()), 4), changed or "-"
