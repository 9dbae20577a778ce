"""One way to run a study: every case under every setting and seed, each a row of figures, in processes."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from itertools import starmap
from multiprocessing import get_context
from typing import Any, Protocol, TypeAlias, TypeVar

Result = TypeVar("Result")
Progress = Callable[[str], None]
"""Called with what runs next, or with what is done."""
Row: TypeAlias = dict[str, Any]
"""What a run came to, by name: `case`, its `group`, `setting`, `seed`, and figures."""


class Case(Protocol):
    """What is run: a scene, a recording, or a kind of made-up scenes."""

    @property
    def name(self) -> str:
        """Unique in the study."""

    @property
    def group(self) -> str:
        """Its part of the report."""

    @property
    def seeded(self) -> bool:
        """Whether it depends on the seed."""


C = TypeVar("C", bound=Case)


def quiet(what: str) -> None:
    """Show no progress."""
    del what


def run_study(
    run: Callable[[C, str, int], Row],
    cases: Sequence[C],
    settings: Sequence[str],
    seeds: Sequence[int],
    *,
    jobs: int = 1,
    progress: Progress = quiet,
) -> list[Row]:
    """Run every case under every setting, with every seed if it depends on the seed; the rows in this order.

    Parameters
    ----------
    run
        Returns the figures of a case under a setting with a seed. Without any figure there is no row.
    cases, settings, seeds
        What is run.
    jobs
        Processes at once; 1: all runs are in this one.
    progress
        Called with one line for each run that is done.
    """
    work = [
        (run, case, setting, seed)
        for case in cases
        for setting in settings
        for seed in (seeds if case.seeded else (0,))
    ]
    rows = []
    with ExitStack() as stack:
        results: Iterable[tuple[Row, Row]] = starmap(_run, work)
        if jobs > 1:
            results = stack.enter_context(_pool(jobs)).map(_run, *zip(*work, strict=True))
        for number, (name, figures) in enumerate(results, start=1):
            progress(f"{number} of {len(work)}: {name['case']}, {name['setting']}, seed {name['seed']}")
            rows += [name | figures] if figures else []
    return rows


def _run(run: Callable[[C, str, int], Row], case: C, setting: str, seed: int) -> tuple[Row, Row]:
    name = {"case": case.name, "group": case.group, "setting": setting, "seed": seed}
    return name, run(case, setting, seed)


def alone(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function in a fresh process, whose peak memory and threads are its own."""
    with _pool(1) as pool:
        return pool.submit(function, *arguments).result()


def _pool(jobs: int) -> ProcessPoolExecutor:
    # A forked process would share locks of threads that numerical libraries started.
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))


def values(rows: Iterable[Row], figure: str, **where: Any) -> list[Any]:
    """A figure of all rows that have it and these names, in order."""
    return [row[figure] for row in rows if figure in row and where.items() <= row.items()]
