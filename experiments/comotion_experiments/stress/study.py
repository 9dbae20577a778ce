"""Every family by name, as ``families.toml`` has them; their runs, and the page of them."""

import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_schemas.errors import KnownError

from ..offline import thesis
from ..study import Row
from ..tables import Column, Table, filled, mean, means
from . import families, metrics
from .scene import Scene


@dataclass(frozen=True)
class Family:
    """A kind of stress: what it is called, where it is listed, and one line on what happens."""

    name: str
    group: str
    title: str
    make: Callable[..., list[Scene]]  # of a seed; keywords are its parameters
    parameters: Mapping[str, Any]
    seeded: bool = True

    def scenes(self, seed: int, **overrides: Any) -> list[Scene]:
        """Make the scenes of a seed; the same for the same seed and parameters."""
        return self.make(seed=seed, **{**self.parameters, **overrides})


def _read() -> dict[str, Family]:
    groups = tomllib.loads(Path(__file__).with_name("families.toml").read_text(encoding="utf-8"))
    defaults, every, rows = groups.pop("defaults"), dict[str, Family](), dict[str, dict[str, Any]]()
    for group, members in groups.items():
        for name, given in members.items():
            rows[name] = row = rows.get(given.pop("like", ""), {}) | given
            maker = row["make"]
            own = {key: value for key, value in row.items() if key not in {"make", "title"}}
            parameters = defaults.get(maker, {}) | own
            every[name] = Family(name, group, row["title"], getattr(families, maker), parameters)
    return every


FAMILIES = _read()


def find_families(names: Sequence[str] = ()) -> list[Family]:
    """Look up families; a name also stands for all that begin with it and an underscore.

    Raises
    ------
    ValueError
        If a name fits none.
    """
    if not names:
        return list(FAMILIES.values())
    chosen: dict[str, Family] = {}
    for name in names:
        fitting = {k: f for k, f in FAMILIES.items() if k == name or k.startswith(f"{name}_")}
        if not fitting:
            raise KnownError(f"no family {name!r}; there are {', '.join(FAMILIES)}")
        chosen.update(fitting)
    return list(chosen.values())


DEFAULT, THESIS = "comotion", "thesis"
METHODS = (DEFAULT, THESIS)
REPORTED_SEEDS = (1, 3, 5, 7, 9)
"""Even seeds are for development."""


def run_family(
    name: str, seed: int, config: FusionConfig | None = None, *, method: str = DEFAULT, **overrides: Any
) -> Row:
    """Run a family of :data:`FAMILIES` and give its metrics by name, means over its scenes.

    By default `config` is that of the `method`: its defaults, or for the thesis method equal weights and a
    switch that suits the noise. `overrides` are parameters of the family.
    """
    scenes = FAMILIES[name].scenes(seed, **overrides)
    usual = [FusionConfig() if method == DEFAULT else thesis(scene.sigma_switch) for scene in scenes]
    return means([run_scene(scene, config or own) for scene, own in zip(scenes, usual, strict=True)])


def run_method(family: Family, method: str, seed: int) -> Row:
    """Run a family under a method."""
    return run_family(family.name, seed, method=method)


def run_scene(scene: Scene, config: FusionConfig) -> dict[str, float]:
    """Run one scene through the core; metrics by name, NaN where one does not apply.

    `nmi_apart` is the mean with bodies as one until they are apart, `nmi` that against the true bodies;
    `delay` (s) and `ids` are means over bodies, `healing` (s) and `kept` over events; `spurious` are events a
    minute beyond the true ones, `switches` tracks per 100 with another hypothesis than an update before,
    `hypotheses` the mean number of confirmed ones, `ms` the median time of an update.
    """
    since = metrics.apart(scene)
    run, moments = metrics.watch(scene, config, since)
    last = moments[-1].t
    # Each with when the next one begins, or the run ends.
    followed = zip(scene.happenings, [*(h.begin for h in scene.happenings[1:]), last], strict=False)
    # A right run shows bodies born at the start, a split for each that moves apart, and two events for each
    # whose features were all lost for a time.
    births = int(since.components(last).max()) + 1
    returns = sum(2 * len(h.bodies) for h in scene.happenings if h.lost and h.end > h.begin)
    spurious = sum(len(m.events) for m in moments) - births - returns
    return {
        "nmi": metrics.mean_nmi(moments, apart=False),
        "nmi_apart": metrics.mean_nmi(moments),
        "delay": mean(metrics.delays(moments, since, last)),
        "healing": mean(metrics.healing(moments, h, min(end, h.end + 10.0)) for h, end in followed),
        "kept": mean(metrics.kept(moments, h) for h in scene.happenings),
        "ids": metrics.ids_per_object(moments, since),
        "spurious": max(spurious, 0) / ((last - scene.start) / 60.0),
        "switches": run.summary.switches_per_100,
        "hypotheses": mean(float(len(m.confirmed)) for m in moments),
        "ms": float(np.median(run.update_ms)),
    }


# NaN where a metric does not apply.
_COLUMNS = (
    Column("nmi_apart", "NMI", 3),
    Column("delay", "delay, s", 2),
    Column("healing", "healing, s", 1),
    Column("kept", "kept", 2),
    Column("ids", "ids", 1),
    Column("spurious", "spurious", 0),
)


def markdown(rows: Sequence[Row]) -> str:
    """For a document and a terminal."""
    families = [FAMILIES[name] for name in dict.fromkeys(row["case"] for row in rows)]
    parts: dict[str, str | Table] = {
        "seeds": ", ".join(str(seed) for seed in dict.fromkeys(row["seed"] for row in rows)),
        "part": f"{len(families)} of {len(FAMILIES)}",
    }
    for group in dict.fromkeys(family.group for family in families):
        of_group = [family for family in families if family.group == group]
        parts[group] = _table(rows, of_group)
    return filled(Path(__file__).with_name("page.md"), parts)


def _table(rows: Sequence[Row], families: Sequence[Family]) -> Table:
    """A line for each family of a group, means over seeds: NMI of each method, the rest of the first one."""
    lines = [[figures for m in METHODS if (figures := _means(rows, family, m))] for family in families]
    # A column without a value in the whole group says nothing.
    columns = [
        column
        for column in _COLUMNS
        if any(not math.isnan(figures[column.key]) for line in lines for figures in line)
    ]
    titles = (column.title for column in columns)
    table = Table(("family", "what happens", *titles), words=2)
    for family, line in zip(families, lines, strict=True):
        shown = (line if column.key == "nmi_apart" else line[:1] for column in columns)
        cells = (
            # A number below 1 without the zero.
            " / ".join(re.sub(r"^0\.", ".", column.of(figures)) for figures in methods)
            for column, methods in zip(columns, shown, strict=True)
        )
        table.add(f"`{family.name}`", family.title, *cells)
    return table


def _means(rows: Sequence[Row], family: Family, method: str) -> dict[str, float]:
    """Means over seeds of a family under a method; empty if it was not run."""
    same = [row for row in rows if (row["case"], row["setting"]) == (family.name, method)]
    return means([{column.key: row[column.key] for column in _COLUMNS} for row in same]) if same else {}
