"""Made-up scenes of every kind in; the list of kernels that each needs out: ``kernel_list.json``.

Run it when kernels have changed: ``PYTHONPATH=tests python -m comotion_tools.kernel_list``. It compiles
everything, in a folder of its own or in a given NUMBA_CACHE_DIR, which must hold nothing else.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, cast

from numba.core import event, types
from numba.core.dispatcher import Dispatcher

from comotion.config import FusionConfig
from comotion.precompiling import LIST, kinds_of_scene, read_types
from comotion.warm_up import SCENES, warm_up

_METHODS = ("comotion", "thesis")


class _Compiled(event.Listener):
    """Kernels in the order in which they have been compiled: what others call comes before them."""

    def __init__(self) -> None:
        self.found: list[tuple[str, str]] = []

    def on_start(self, event: event.Event) -> None:
        """Nothing has been compiled yet."""

    def on_end(self, event: event.Event) -> None:
        """One has."""
        function = event.data["dispatcher"].py_func
        self.found.append((f"{function.__module__}:{function.__qualname__}", spelled(event.data["args"])))


def main() -> None:
    """Write the list; with a kind on the command line, print what that kind compiles and calls."""
    if sys.argv[1:]:
        method, number, sources = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
        sys.stdout.write(json.dumps(_needed(method, number, sources)))
        return
    needed: dict[tuple[str, str], list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {"NUMBA_CACHE_DIR": folder} | os.environ
        for kind, *arguments in _kinds():
            # Each in a process of its own, which has loaded nothing else.
            command = [sys.executable, "-P", "-m", __spec__.name, *arguments]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment)
            for kernel, text in json.loads(done.stdout):
                needed.setdefault((kernel, text), []).append(kind)
    lines = ",\n".join(json.dumps([*one, kinds]) for one, kinds in needed.items())
    LIST.write_text(f"[\n{lines}\n]\n")


def _kinds() -> Iterator[tuple[str, str, str, str]]:
    """Each kind with its arguments."""
    for method in _METHODS:
        for number, (unit, dim, _, most) in enumerate(SCENES):
            for sources in range(1, most + 1):
                yield kinds_of_scene(method, unit, dim, sources)[-1], method, str(number), str(sources)


def _needed(method: str, number: int, sources: int) -> list[Any]:
    """What is compiled, and then what is called, as kernels and spelled types."""
    unit, dim, features, _ = SCENES[number]
    compiled, config = _Compiled(), FusionConfig.model_validate({"method": method})
    with event.install_listener("numba:compile", compiled):
        for _ in warm_up(config, unit, dim, features, sources):
            pass
    ours = kernels()
    called = [(name, spelled(tuple(one))) for name, kernel in ours.items() for one in kernel.signatures]
    known = dict.fromkeys([*compiled.found, *sorted(called)])
    return [(name, text) for name, text in known if text and name in ours]


def kernels() -> dict[str, Dispatcher]:
    """Every kernel of the core that this process has imported, by ``module:name``."""
    modules = [module for name, module in sys.modules.items() if name.startswith("comotion.")]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher))
    return {f"{one.py_func.__module__}:{one.py_func.__qualname__}": one for one in found}


def spelled(arguments: tuple[Any, ...]) -> str:
    """Types of arguments as JSON; empty where they cannot be read back, as with literals."""
    text = json.dumps([_spell(one) for one in arguments])
    with suppress(AttributeError, ImportError, ValueError, TypeError):
        if read_types(text) == tuple(arguments):
            return text
    return ""


def _spell(one: Any) -> Any:
    if isinstance(one, types.Array):
        return f"{one.dtype} {one.ndim}{one.layout}"
    if isinstance(one, types.BaseTuple):
        named = getattr(one, "instance_class", tuple)
        return [f"{named.__module__}:{named.__qualname__}", *map(_spell, cast("Any", one))]
    return str(one)


if __name__ == "__main__":
    main()
