"""Grouping in pixel space on labelled recordings: error, number of objects, time."""

from . import report
from .benchmark import LENGTHS, Benchmark, run_benchmark
from .sequences import DATA_SETS, Sequence, find_data_sets

__all__ = ["DATA_SETS", "LENGTHS", "Benchmark", "Sequence", "find_data_sets", "report", "run_benchmark"]
