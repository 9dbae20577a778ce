"""Reproduces the figures of the thesis, with the thesis method and the default method side by side."""

from .catalogue import FIGURES, select
from .study import Figure, Options, Study

__all__ = ["FIGURES", "Figure", "Options", "Study", "select"]
