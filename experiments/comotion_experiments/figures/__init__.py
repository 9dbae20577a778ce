"""Reproduces the figures of the thesis, with the thesis method and the default method side by side."""

from .catalogue import FIGURES, select
from .experiment import Results, reproduce
from .study import Figure, Options, Row

__all__ = ["FIGURES", "Figure", "Options", "Results", "Row", "reproduce", "select"]
