"""Grouping in pixel space on labelled recordings: error, number of objects, time."""

from .benchmark import lines, markdown, run_benchmark, table
from .sequences import find_data_sets

__all__ = ["find_data_sets", "lines", "markdown", "run_benchmark", "table"]
