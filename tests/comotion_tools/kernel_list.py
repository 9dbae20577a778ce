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
from typing import Any

from numba.core import event

from comotion.config import FusionConfig
from comotion.precompiling import LIST, kernels, kinds_of_scene, spelled, within
from comotion.warm_up import SCENES, warm_up_scene

_METHODS = ("comotion", "thesis")


class _Compiled(event.Listener):
    """Kernels in the order in which they have been compiled: what others call comes before them."""

    def __init__(self) -> None:
        self.found: list[tuple[str, str | None]] = []

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
            # Each in a process of its own, which has loaded nothing else. What the second one has loaded is
            # called from outside of all kernels; what was compiled without that is called within them.
            command = [sys.executable, "-P", "-m", __spec__.name, *arguments]
            for keys in (within([kind]), [kind]):
                done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment)
                for kernel, types in json.loads(done.stdout)[keys == [kind]]:
                    needed.setdefault((kernel, types), []).extend(keys)
    lines = ",\n".join(json.dumps([*one, kinds]) for one, kinds in needed.items())
    LIST.write_text(f"[\n{lines}\n]\n")


def _kinds() -> Iterator[tuple[str, str, str, str]]:
    """Each kind with its arguments."""
    for method in _METHODS:
        for number, (unit, dim, _, most) in enumerate(SCENES):
            for sources in range(1, most + 1):
                yield kinds_of_scene(method, unit, dim, sources)[-1], method, str(number), str(sources)


def _needed(method: str, number: int, sources: int) -> tuple[list[Any], list[Any]]:
    """What is compiled, and what is called, each as kernels and spelled types."""
    unit, dim, features, _ = SCENES[number]
    compiled = _Compiled()
    with event.install_listener("numba:compile", compiled):
        for _ in warm_up_scene(FusionConfig.model_validate({"method": method}), unit, dim, features, sources):
            pass
    called = [(name, spelled(tuple(one))) for name, kernel in kernels().items() for one in kernel.signatures]
    known = [[(name, text) for name, text in some if text] for some in (compiled.found, called)]
    ours = kernels().keys()
    return [one for one in known[0] if one[0] in ours], sorted(known[1])


if __name__ == "__main__":
    main()
