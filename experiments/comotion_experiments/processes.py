"""Runs of experiments in processes of their own."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

Result = TypeVar("Result")
Progress = Callable[[str], None]
"""Called with what runs next, or with what is done."""


def quiet(what: str) -> None:
    """Show no progress."""
    del what


def run_all(
    function: Callable[..., Result],
    work: Sequence[tuple[Any, ...]],
    jobs: int,
    said: Callable[[Result], str],
    progress: Progress = quiet,
) -> Iterator[Result]:
    """Call a function with every tuple of arguments, and yield the results in the order in which they come.

    Parameters
    ----------
    function, work
        What is called, and with what.
    jobs
        Processes at once; 1: all calls are in this one.
    said
        One line on a result.
    progress
        Called with this line for each run that is done.
    """
    for done, result in enumerate(_results(function, work, jobs), start=1):
        progress(f"{done} of {len(work)}: {said(result)}")
        yield result


def _results(function: Callable[..., Result], work: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[Result]:
    if jobs <= 1:
        yield from (function(*arguments) for arguments in work)
        return
    with _pool(jobs) as pool:
        for future in as_completed([pool.submit(function, *arguments) for arguments in work]):
            yield future.result()


def alone(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function in a fresh process, whose peak memory and threads are its own."""
    with _pool(1) as pool:
        return pool.submit(function, *arguments).result()


def _pool(jobs: int) -> ProcessPoolExecutor:
    # A forked process would share locks of threads that numerical libraries started.
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
