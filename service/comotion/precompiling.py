"""Kernels of a method compiled before they are called, by a process on every core; the result is on disk.

A first call would compile one kernel after the other, in one process. `kernel_list.json` names the
signatures that each kind of scene needs, and ``make schemas`` makes it again. What it does not name, or
names wrongly, is compiled where it is called: the list costs no correctness.
"""

import gc
import json
import os
import selectors
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, cast

from numba.core import types
from numba.core.dispatcher import Dispatcher

from .compiled import folder

LIST = Path(__file__).with_name("kernel_list.json")
# More compile the library code of Numba once more each, and take memory.
_MAX_PROCESSES = 4
# Fewer are compiled here sooner than another process starts.
_WORTH_PROCESSES = 8
# File of what has been compiled, beside it.
_TRIED = "ahead.jsonl"


class Task(NamedTuple):
    """A kernel as ``module:name``, and the spelled types of its arguments."""

    kernel: str
    arguments: str

    @property
    def dispatcher(self) -> Any:
        """The kernel, a Dispatcher."""
        module, _, name = self.kernel.partition(":")
        found = getattr(import_module(module), name)
        if not isinstance(found, Dispatcher):
            raise TypeError(f"{self.kernel} is not compiled")
        return found

    def is_here(self) -> bool:
        """Whether there are such a kernel and types: the list may be of other sources."""
        with suppress(ImportError, AttributeError, TypeError, ValueError):
            return bool(self.dispatcher and read_types(self.arguments))
        return False

    def compile(self) -> None:
        """Compile it, or load it from the disk. What fails here fails where it is called, and says why."""
        with suppress(Exception):
            self.dispatcher.compile(read_types(self.arguments))


def kernels() -> dict[str, Dispatcher]:
    """Every kernel of the core that this process has imported, by ``module:name``."""
    modules = [module for name, module in sys.modules.items() if name.startswith("comotion.")]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher))
    return {f"{one.py_func.__module__}:{one.py_func.__qualname__}": one for one in found}


def kinds_of_scene(method: str, unit: str, dim: int, sources: int) -> list[str]:
    """Keys of the list; several sources need what one needs, and more."""
    one = f"{method} {unit}{dim}"
    return [one, f"{one} several"] if sources > 1 else [one]


def within(kinds: list[str]) -> list[str]:
    """Keys of what is called within the kernels of some kinds of scenes alone."""
    return [f"{kind} within" for kind in kinds]


@cache
def entries() -> list[tuple[str, str, list[str]]]:
    """Kernels, spelled types and keys, callees before callers; nothing where the list cannot be read."""
    with suppress(OSError, ValueError):
        return [(kernel, types_, kinds) for kernel, types_, kinds in json.loads(LIST.read_text())]
    return []


def kinds_of_method(method: str) -> list[str]:
    """All keys of a method."""
    found = {kind for *_, kinds in entries() for kind in kinds if kind.startswith(f"{method} ")}
    return sorted(kind for kind in found if not kind.endswith(" within"))


def compile_ahead(kinds: list[str]) -> Iterator[tuple[int, int]]:
    """Compile what is missing on the disk for some kinds of scenes.

    Yields
    ------
    tuple
        Kernels done and to do, one time before the first. Nothing where nothing is missing.
    """
    tried = _tried()
    missing = [task for task in _listed([*kinds, *within(kinds)]) if task not in tried]
    if missing:
        yield 0, len(missing)
    apart = len(missing) >= _WORTH_PROCESSES and folder() is not None
    done = set[Task]()
    for task in chain(_share_out(missing) if apart else (), _compiled_here(missing, done)):
        done.add(task)
        _note(task)
        yield len(done), len(missing)


def _compiled_here(tasks: list[Task], done: set[Task]) -> Iterator[Task]:
    """Compile what is not `done` when its turn comes."""
    for task in tasks:
        if task not in done:
            task.compile()
            yield task


def load(kinds: list[str]) -> bool:
    """Load all that some kinds of scenes need, if it has been compiled; returns whether it has."""
    tasks = _listed(kinds)
    if not tasks or not _tried().issuperset(tasks):
        return False
    for task in tasks:
        task.compile()
    return True


def spelled(arguments: tuple[Any, ...]) -> str | None:
    """Types of arguments as JSON; None where they cannot be read back, as with literals."""
    text = json.dumps([_spell(one) for one in arguments])
    with suppress(AttributeError, ImportError, ValueError, TypeError):
        if read_types(text) == tuple(arguments):
            return text
    return None


def read_types(text: str) -> tuple[Any, ...]:
    """Types that :func:`spelled` has written."""
    return tuple(_read(one) for one in json.loads(text))


def _spell(one: Any) -> Any:
    if isinstance(one, types.Array):
        return f"{one.dtype} {one.ndim}{one.layout}"
    if isinstance(one, types.BaseTuple):
        named = getattr(one, "instance_class", tuple)
        return [f"{named.__module__}:{named.__qualname__}", *map(_spell, cast("Any", one))]
    return str(one)


def _read(one: Any) -> Any:
    if isinstance(one, list):
        module, _, name = one[0].partition(":")
        named = getattr(import_module(module), name)
        members = tuple(map(_read, one[1:]))
        return types.BaseTuple.from_types(members, None if named is tuple else named)  # type: ignore[no-untyped-call]
    dtype, _, shape = one.partition(" ")
    scalar = types.boolean if dtype == "bool" else getattr(types, dtype)
    return types.Array(scalar, int(shape[:-1]), shape[-1]) if shape else scalar


def _listed(kinds: list[str]) -> list[Task]:
    tasks = [Task(kernel, types_) for kernel, types_, needed in entries() if set(kinds) & set(needed)]
    return [task for task in tasks if task.is_here()]


def _tried() -> set[Task]:
    """What has been compiled and is on the disk; what could not be is not tried again either."""
    kept = folder()
    with suppress(OSError, ValueError, TypeError):
        lines = [] if kept is None else (kept / _TRIED).read_text().splitlines()
        return {Task(*json.loads(line)) for line in lines}
    return set()


def _note(task: Task) -> None:
    if (kept := folder()) is not None:
        with suppress(OSError), (kept / _TRIED).open("a") as file:
            file.write(f"{json.dumps(task)}\n")


def _share_out(tasks: list[Task]) -> Iterator[Task]:
    """Give tasks to processes; yields those that are done."""
    waiting, busy = iter(tasks), dict[int, Task]()
    processes: list[subprocess.Popen[bytes]] = []
    try:
        with suppress(OSError):  # where no process can be started, this one compiles
            while len(processes) < min(_MAX_PROCESSES, len(os.sched_getaffinity(0))):
                processes.append(_worker())
        with selectors.DefaultSelector() as selector:
            for process in processes:
                selector.register(process.stdout, selectors.EVENT_READ, process)  # type: ignore[arg-type]
            while selector.get_map():
                for key, _ in selector.select():
                    # Every line of a process asks for work: the first too.
                    process, lives = key.data, bool(key.data.stdout.readline())
                    done = busy.pop(process.pid, None)
                    task = next(waiting, None) if lives else None
                    if task is None:
                        selector.unregister(key.fileobj)
                    else:
                        busy[process.pid] = task
                        with suppress(OSError):  # it has ended: select will tell
                            process.stdin.write(f"{json.dumps(task)}\n".encode())
                    if lives and done is not None:
                        yield done
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def _worker() -> "subprocess.Popen[bytes]":
    """Start a process; it finds the modules of this one."""
    command = [sys.executable, "-P", "-c", f"from {__name__} import _work; _work()"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    pipe = subprocess.PIPE
    return subprocess.Popen(  # noqa: S603
        command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, env=environment, bufsize=0
    )


def _work() -> None:
    """Compile what comes on standard input, a line each; a line out when ready for the next."""
    # The compiler makes many objects that stay: looking through them took a tenth of the time.
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)
    while True:
        sys.stdout.write("\n")
        sys.stdout.flush()
        line = sys.stdin.readline()
        if not line:
            return
        Task(*json.loads(line)).compile()
