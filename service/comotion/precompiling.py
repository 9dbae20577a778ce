"""Kernels of a method compiled before they are called, by a process on every core; the result is on disk.

A first call would compile one kernel after the other, in one process. `kernel_list.json` names the
signatures that each kind of scene needs, and ``make schemas`` makes it again. What it does not name, or
names wrongly, is compiled where it is called: the list costs no correctness.
"""

import gc
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from numba.core import types

from .compiled import folder

LIST = Path(__file__).with_name("kernel_list.json")
# More compile the library code of Numba once more each, and take memory.
_MAX_PROCESSES = 4
# Fewer are compiled where they are called sooner than another process starts.
_WORTH_PROCESSES = 8
# Bytes of a number that travels between processes: what is written or read at once stays whole.
_NUMBER = 4
# A file that says that all kernels of a kind of scene have been compiled.
_DONE = ".done"


@cache
def entries() -> list[tuple[str, str, list[str]]]:
    """Kernels, spelled types and kinds, callees before callers; nothing where the list cannot be read."""
    with suppress(OSError, ValueError):
        return [(kernel, types_, kinds) for kernel, types_, kinds in json.loads(LIST.read_text())]
    return []


def kinds_of_scene(method: str, unit: str, dim: int, sources: int) -> list[str]:
    """Kinds in the list; several sources need what one needs, and more."""
    one = f"{method} {unit}{dim}"
    return [one, f"{one} several"] if sources > 1 else [one]


def kinds_of_method(method: str) -> list[str]:
    """All kinds of scenes of a method."""
    return sorted({kind for *_, kinds in entries() for kind in kinds if kind.startswith(f"{method} ")})


def compile_ahead(kinds: list[str]) -> Iterator[tuple[int, int]]:
    """Compile what is missing on the disk for some kinds of scenes.

    Yields
    ------
    tuple
        Kernels done and to do, one time before the first. Nothing where little is missing.
    """
    kept = folder()
    if kept is None:
        return
    done = {file.stem for file in kept.glob(f"*{_DONE}")}
    missing = [k for k, (*_, needed) in enumerate(entries()) if {*kinds} & {*needed} and not done & {*needed}]
    if len(missing) < _WORTH_PROCESSES:
        return
    yield 0, len(missing)
    count = 0
    for count, _ in enumerate(_share_out(missing), 1):
        yield count, len(missing)
    if count == len(missing):
        for kind in kinds:
            (kept / f"{kind}{_DONE}").touch()


def load(kinds: list[str]) -> None:
    """Load all that some kinds of scenes need; what is not on the disk is compiled."""
    for number, (*_, needed) in enumerate(entries()):
        if {*kinds} & {*needed}:
            _compile(number)


def read_types(text: str) -> tuple[Any, ...]:
    """Types of arguments that the list spells: arrays as ``float64 2C``, tuples as lists with their class."""
    return tuple(_read(one) for one in json.loads(text))


def _read(one: Any) -> Any:
    if isinstance(one, list):
        module, _, name = one[0].partition(":")
        named = getattr(import_module(module), name)
        members = tuple(map(_read, one[1:]))
        return types.BaseTuple.from_types(members, None if named is tuple else named)  # type: ignore[no-untyped-call]
    dtype, _, shape = one.partition(" ")
    scalar = types.boolean if dtype == "bool" else getattr(types, dtype)
    return types.Array(scalar, int(shape[:-1]), shape[-1]) if shape else scalar


def _compile(number: int) -> None:
    """Compile a kernel of the list, or load it. What fails here fails where it is called, and says why."""
    kernel, types_, _ = entries()[number]
    module, _, name = kernel.partition(":")
    with suppress(Exception):
        getattr(import_module(module), name).compile(read_types(types_))


def _share_out(numbers: list[int]) -> Iterator[int]:
    """Give kernels to processes, which take the next one from a pipe each; yields those that are done."""
    (tasks, give), (results, result) = os.pipe(), os.pipe()
    os.write(give, b"".join(number.to_bytes(_NUMBER) for number in numbers))
    os.close(give)
    # A process finds the modules of this one.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-P", "-c", f"from {__name__} import _work; _work()"]
    processes: list[subprocess.Popen[bytes]] = []
    try:
        with suppress(OSError):  # where no process can be started, kernels are compiled where they are called
            while len(processes) < min(_MAX_PROCESSES, len(os.sched_getaffinity(0))):
                processes.append(
                    subprocess.Popen(  # noqa: S603
                        command, stdin=tasks, stdout=result, stderr=subprocess.DEVNULL, env=environment
                    )
                )
        os.close(result)
        while done := os.read(results, _NUMBER):
            yield int.from_bytes(done)
    finally:
        for process in processes:
            process.kill()
            process.wait()
        os.close(tasks)
        os.close(results)


def _work() -> None:
    """Compile the kernels whose numbers come on standard input; each is written out when it is done."""
    # The compiler makes many objects that stay: looking through them took a tenth of the time.
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)
    while number := os.read(0, _NUMBER):
        _compile(int.from_bytes(number))
        os.write(1, number)
