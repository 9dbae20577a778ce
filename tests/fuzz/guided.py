"""``python -m tests.fuzz.guided TARGET [SECONDS]``: inputs guided by coverage (``pip install atheris``).

A finding is written to the present folder; in tests/fuzz/corpus/TARGET the suite replays it from then on.
"""

import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from types import FunctionType

import atheris

from .targets import TARGETS, corpus


def functions(names):
    """Functions of modules and of their classes, with where they are kept."""
    for module in [m for m in list(sys.modules.values()) if getattr(m, "__name__", "").startswith(names)]:
        for holder in (module, *(v for v in vars(module).values() if isinstance(v, type))):
            if getattr(holder, "__module__", module.__name__) == module.__name__:
                found = list(vars(holder).items())
                yield from ((holder, name, one) for name, one in found if isinstance(one, FunctionType))


if __name__ == "__main__":
    name, seconds, target = sys.argv[1], [*sys.argv[2:], "60"][0], TARGETS[sys.argv[1]]
    for holder, attribute, function in list(functions(target.modules)):
        with suppress(Exception):  # what cannot be instrumented is run as it is
            setattr(holder, attribute, atheris.instrument_func(function))
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-"))
    for k, data in enumerate(corpus(name)):
        (folder / str(k)).write_bytes(data)
    options = ["-print_final_stats=1", "-rss_limit_mb=4096", "-timeout=30", "-max_len=20000"]
    atheris.Setup([sys.argv[0], f"-max_total_time={seconds}", *options, str(folder)], target.check)
    atheris.Fuzz()  # ends the process
