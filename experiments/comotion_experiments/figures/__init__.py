"""Reproduces the figures of the thesis, with the thesis method and the default method side by side."""

from .catalogue import FIGURES, select
from .experiment import Made, Results, reproduce
from .figure import Figure, Row
from .study import Options

__all__ = ["FIGURES", "Figure", "Made", "Options", "Results", "Row", "reproduce", "select"]
