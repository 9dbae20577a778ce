"""What a figure is: its name and story, how it is drawn, and what comes of that."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .runs import SceneRuns
from .study import Study


@dataclass(frozen=True)
class Row:
    """One number, or claim, of the thesis beside what both methods give here."""

    quantity: str
    printed: str
    thesis: str
    default: str


@dataclass(frozen=True)
class Drawn:
    """A drawn figure.

    Attributes
    ----------
    figure
        The matplotlib figure.
    rows
        Numbers beside those of the thesis.
    parameters
        What it was made with, by name.
    curves
        What is drawn as a curve, by its label.
    summary
        Mean NMI of the thesis method at its best, and of the default method; None where there is no curve.
    """

    figure: Any
    rows: Sequence[Row]
    parameters: Mapping[str, str]
    curves: Mapping[str, SceneRuns] = field(default_factory=dict)
    summary: tuple[str, str] | None = None


@dataclass(frozen=True)
class Figure:
    """A figure of the thesis.

    Attributes
    ----------
    name
        Its number there, e.g. ``4.4``.
    title
        One line.
    shows
        What is to be seen, and what the thesis says about it.
    draw
        Runs what is needed and draws.
    workcell
        Whether it needs the workcell (extra ``sim3d``).
    """

    name: str
    title: str
    shows: str
    draw: Callable[[Study], Drawn]
    workcell: bool = False

    @property
    def file(self) -> str:
        """Name of its picture."""
        return f"fig{self.name.replace('.', '_')}.png"
