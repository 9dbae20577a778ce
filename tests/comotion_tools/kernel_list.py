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

from numba.core.dispatcher import Dispatcher

from comotion.config import FusionConfig
from comotion.precompiling import LIST, Task, callees_of, kinds_of_scene, spelled
from comotion.runtime.warm_up import SCENES, warm_up_scene

_METHODS = ("comotion", "thesis")


def main() -> None:
    """Write the list; with a kind on the command line, print what that kind needs."""
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
            for kernel, types in json.loads(done.stdout):
                needed.setdefault((kernel, types), []).append(kind)
    lines = ",\n".join(json.dumps([*one, kinds]) for one, kinds in sorted(needed.items()))
    LIST.write_text(f"[\n{lines}\n]\n")


def _kinds() -> Iterator[tuple[str, str, str, str]]:
    """Each kind with its arguments."""
    for method in _METHODS:
        for number, (unit, dim, _, most) in enumerate(SCENES):
            for sources in range(1, most + 1):
                yield kinds_of_scene(method, unit, dim, sources)[-1], method, str(number), str(sources)


def _needed(method: str, number: int, sources: int) -> list[tuple[str, str]]:
    unit, dim, features, _ = SCENES[number]
    for _ in warm_up_scene(FusionConfig.model_validate({"method": method}), unit, dim, features, sources):
        pass
    called = {f"{one.py_func.__module__}:{one.py_func.__qualname__}" for one in _called()}
    # Of what those call within, it is known on the disk alone.
    within = set().union(*map(callees_of, called))
    found = []
    for kernel in sorted(within | called):
        one = Task(kernel, "").dispatcher
        on_disk = one._cache.signatures(one.targetctx) if kernel in within else one.signatures
        texts = sorted(filter(None, (spelled(tuple(arguments)) for arguments in on_disk)))
        found += [(kernel, text) for text in texts]
    return found


def kernels() -> dict[str, Dispatcher]:
    """Every kernel of the core that this process has imported, by name."""
    modules = [module for name, module in sys.modules.items() if name.startswith("comotion.")]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher))
    return {f"{one.py_func.__module__}.{one.py_func.__qualname__}": one for one in found}


def _called() -> list[Dispatcher]:
    return [one for one in kernels().values() if one.signatures]


if __name__ == "__main__":
    main()
