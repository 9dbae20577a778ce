"""The results of an ablation as Markdown and as plain values."""

from dataclasses import asdict
from typing import Any

import numpy as np

from .experiment import SCATTER, WHOLE, Results
from .rules import RULES

_SHOWN = 4


def markdown(results: Results) -> str:
    """A table with a line for each rule."""
    lines = [
        "# Ablation",
        "",
        "Made by `comotion reproduce ablation`. Each rule of the default method is left out alone; mean NMI",
        f"over all updates. Stress families with seeds {', '.join(map(str, results.seeds))}, and recordings.",
        f"The last column names scenes that change by more than {SCATTER:.3f}, the largest changes first.",
        "",
        "| left out | families | recordings | changes |",
        "|---|---:|---:|---|",
        _line(results, WHOLE, "nothing"),
    ]
    run = dict.fromkeys(one.rule for one in results.runs)
    lines += [_line(results, name, f"`{name}`: {RULES[name].what}") for name in run if name != WHOLE]
    return "\n".join(lines) + "\n"


def as_json(results: Results) -> dict[str, Any]:
    """Plain values."""
    return {"seeds": list(results.seeds), "runs": [asdict(run) for run in results.runs]}


def _line(results: Results, rule: str, title: str) -> str:
    families, recordings = (results.means(rule, recorded=recorded) for recorded in (False, True))
    whole = results.means(WHOLE, recorded=False) | results.means(WHOLE, recorded=True)
    changes = {name: nmi - whole[name] for name, nmi in (families | recordings).items()}
    largest = sorted(changes.items(), key=lambda item: -abs(item[1]))[:_SHOWN]
    changed = ", ".join(f"{name} {change:+.3f}" for name, change in largest if abs(change) > SCATTER)
    return f"| {title} | {_mean(families)} | {_mean(recordings)} | {changed or '-'} |"


def _mean(found: dict[str, float]) -> str:
    return f"{np.mean(list(found.values())):.4f}" if found else "-"
