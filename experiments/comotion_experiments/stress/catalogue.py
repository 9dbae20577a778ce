"""Every family by name, as ``families.toml`` has them."""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comotion_schemas.errors import KnownError

from . import families
from .scene import Scene

TEN_MINUTES = "ten minutes"


@dataclass(frozen=True)
class Family:
    """A kind of stress: what it is called, where it is listed, and one line on what happens."""

    name: str
    group: str
    title: str
    make: Callable[..., list[Scene]]  # of a seed; keywords are its parameters
    parameters: Mapping[str, Any]
    seeded: bool = True

    @property
    def slow(self) -> bool:
        """Whether a quick run leaves it out."""
        return self.group == TEN_MINUTES

    def scenes(self, seed: int, **overrides: Any) -> list[Scene]:
        """Make the scenes of a seed; the same for the same seed and parameters."""
        return self.make(seed=seed, **{**self.parameters, **overrides})


def _read() -> dict[str, Family]:
    groups = tomllib.loads(Path(__file__).with_name("families.toml").read_text(encoding="utf-8"))
    defaults, found, rows = groups.pop("defaults"), dict[str, Family](), dict[str, dict[str, Any]]()
    for group, members in groups.items():
        for name, given in members.items():
            rows[name] = row = rows.get(given.pop("like", ""), {}) | given
            maker = row["make"]
            own = {key: value for key, value in row.items() if key not in {"make", "title"}}
            parameters = defaults.get(maker, {}) | own
            found[name] = Family(name, group, row["title"], getattr(families, maker), parameters)
    return found


FAMILIES = _read()


def find_families(names: Sequence[str] = (), *, quick: bool = False) -> list[Family]:
    """Look up families; a name also stands for all that begin with it and an underscore.

    Raises
    ------
    ValueError
        If a name fits none.
    """
    if not names:
        return [family for family in FAMILIES.values() if not (quick and family.slow)]
    chosen: dict[str, Family] = {}
    for name in names:
        fitting = {k: f for k, f in FAMILIES.items() if k == name or k.startswith(f"{name}_")}
        if not fitting:
            raise KnownError(f"no family {name!r}; there are {', '.join(FAMILIES)}")
        chosen.update(fitting)
    return list(chosen.values())
