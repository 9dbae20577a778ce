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
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, cast

from numba.core import types
from numba.core.dispatcher import Dispatcher

from .kernel_cache import KernelCache, source_digest

LIST = Path(__file__).with_name("kernel_list.json")
# More compile the library code of Numba once more each, and take memory.
_MOST_PROCESSES = 4
# Fewer are compiled here sooner than another process starts.
_WORTH_PROCESSES = 8


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


def kinds_of_scene(method: str, unit: str, dim: int, sources: int) -> list[str]:
    """Keys of the list; several sources need what one needs, and more."""
    one = f"{method} {unit}{dim}"
    return [one, f"{one} several"] if sources > 1 else [one]


@cache
def entries() -> list[tuple[str, str, list[str]]]:
    """Kernels, spelled types and kinds of scenes, as listed; nothing where the list cannot be read."""
    with suppress(OSError, ValueError):
        return [(kernel, types_, kinds) for kernel, types_, kinds in json.loads(LIST.read_text())]
    return []


def kinds_of_method(method: str) -> list[str]:
    """All keys of a method."""
    return sorted({kind for *_, kinds in entries() for kind in kinds if kind.startswith(f"{method} ")})


def compile_ahead(kinds: list[str]) -> Iterator[tuple[int, int]]:
    """Compile what is missing on the disk for some kinds of scenes.

    Yields
    ------
    tuple
        Kernels done and to do, one time before the first. Nothing where nothing is missing, or nothing can
        be kept on disk.
    """
    tasks = _listed(kinds)
    mark = _mark(tasks, kinds)
    if mark is None or mark.exists():
        return
    missing = [task for task in tasks if not _is_kept(task)]
    done = 0
    if len(missing) >= _WORTH_PROCESSES:
        yield done, len(missing)
        for done in _share_out(missing):
            yield done, len(missing)
    # What was tried is not tried again, even where the list is of other sources.
    if len(missing) < _WORTH_PROCESSES or done == len(missing):
        with suppress(OSError):
            mark.touch()


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


def _mark(tasks: list[Task], kinds: list[str]) -> Path | None:
    """File that says that all is on the disk; None where nothing can be."""
    kept = getattr(tasks[0].dispatcher, "_cache", None) if tasks else None
    if not isinstance(kept, KernelCache):
        return None
    name = "-".join(kinds).replace(" ", "_")
    return Path(kept.cache_path) / f"{name}-{source_digest()}.ahead"


def _is_kept(task: Task) -> bool:
    kernel = task.dispatcher
    wanted = read_types(task.arguments)
    if not isinstance(getattr(kernel, "_cache", None), KernelCache):
        return False
    return any(found == wanted for found in kernel._cache.signatures(kernel.targetctx))


def _share_out(tasks: list[Task]) -> Iterator[int]:
    """Give tasks to processes, callees first; yields how many are done."""
    processes: list[subprocess.Popen[bytes]] = []
    queue = _Queue(tasks)
    try:
        with suppress(OSError):  # where no process can be started, this one compiles
            while len(processes) < min(_MOST_PROCESSES, len(os.sched_getaffinity(0))):
                processes.append(_worker())
        with selectors.DefaultSelector() as selector:
            for process in processes:
                selector.register(process.stdout, selectors.EVENT_READ, process)  # type: ignore[arg-type]
            while selector.get_map() and not queue.is_done:
                for key, _ in selector.select():
                    # Every line of a process asks for work: the first too.
                    lives = bool(key.data.stdout.readline())
                    if not lives:
                        selector.unregister(key.fileobj)
                    queue.ask(key.data, lives=lives)
                yield queue.done
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
        task = Task(*json.loads(line))
        # What fails here fails where it is called, and says why.
        with suppress(Exception):
            task.dispatcher.compile(read_types(task.arguments))


class _Queue:
    """Tasks in an order in which callees come first, and what most others wait for before the rest."""

    def __init__(self, tasks: list[Task]) -> None:
        self.done = 0
        self._busy: dict[int, Task] = {}
        self._idle: list[subprocess.Popen[bytes]] = []
        names = {task.kernel for task in tasks}
        self._callees = {name: (callees_of(name) & names) - {name} for name in names}
        waited_for = Counter(one for below in self._callees.values() for one in below)
        self._waiting = sorted(tasks, key=lambda task: -waited_for[task.kernel])

    @property
    def is_done(self) -> bool:
        return not self._waiting and not self._busy

    def ask(self, process: "subprocess.Popen[bytes]", *, lives: bool = True) -> None:
        """A process is ready, or has ended; give out what can be begun."""
        self.done += self._busy.pop(process.pid, None) is not None
        if lives:
            self._idle.append(process)
        while self._idle and (task := self._next()) is not None:
            process = self._idle.pop()
            self._waiting.remove(task)
            self._busy[process.pid] = task
            with suppress(OSError):  # it has ended: select will tell
                process.stdin.write(f"{json.dumps(task)}\n".encode())  # type: ignore[union-attr]

    def _next(self) -> Task | None:
        open_ = {task.kernel for task in (*self._waiting, *self._busy.values())}
        ready = (task for task in self._waiting if not self._callees[task.kernel] & open_)
        # Kernels that call each other would wait for ever.
        return next(ready, None if self._busy or not self._waiting else self._waiting[0])


def callees_of(name: str) -> set[str]:
    """All kernels that a kernel needs to be compiled: it calls them, or what it calls does."""
    found: set[str] = set()
    waiting = set(_callees(name))
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting |= _callees(one)
    return found


@cache
def _callees(name: str) -> frozenset[str]:
    """Kernels that a kernel calls by their names."""
    function = Task(name, "").dispatcher.py_func
    called = (function.__globals__.get(one) for one in function.__code__.co_names)
    kernels = (one.py_func for one in called if isinstance(one, Dispatcher))
    return frozenset(f"{one.__module__}:{one.__qualname__}" for one in kernels)
