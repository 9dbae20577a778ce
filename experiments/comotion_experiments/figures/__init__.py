"""Reproduces the figures of the thesis, with the thesis method and the default method side by side.

``figures.toml`` has those that show results.
"""

import tomllib
from collections.abc import Sequence
from importlib import import_module, resources
from typing import Any

from comotion_schemas.errors import KnownError

from .study import Figure, Options, Study

__all__ = ["FIGURES", "Figure", "Options", "Study", "select"]


def _figure(name: str, title: str, shows: str, draw: str, shot: str | None = None) -> Figure:
    module, function = draw.split(".")
    source = import_module(f".{module}", __package__)
    drawn: Any = getattr(source, function)
    if shot is not None:
        drawn = drawn(getattr(source, shot))
    return Figure(name, title, " ".join(shows.split()), drawn, workcell=shot is not None)


_TEXT = (resources.files(__package__) / "figures.toml").read_text(encoding="utf-8")
FIGURES = tuple(_figure(**row) for row in tomllib.loads(_TEXT)["figure"])


def select(names: Sequence[str] | None) -> list[Figure]:
    """Select figures by their numbers.

    Each of `names` is a number, or several separated by commas; None: all figures.

    Raises
    ------
    ValueError
        If there is no such figure.
    """
    if names is None:
        return list(FIGURES)
    wanted = [part.strip() for name in names for part in name.split(",")]
    numbers = [figure.name for figure in FIGURES]
    for name in wanted:
        if name not in numbers:
            raise KnownError(f"no figure {name!r}; one of {', '.join(numbers)}")
    return [figure for figure in FIGURES if figure.name in wanted]
