"""``python -m tests.fuzz.run TARGET...``: fuzz for some time, and report what it took.

With atheris (``pip install atheris``) coverage guides the inputs; otherwise they are mutations of the corpus.
A finding is written to tests/fuzz/corpus/TARGET, where the suite replays it from then on.
"""

import argparse
import hashlib
import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from types import FunctionType

from .mutation import mutated
from .targets import CORPUS, TARGETS, corpus

_SLOW_S = 1.0


def fuzz(name: str, seconds: float, seed: int) -> dict[str, object]:
    """Mutate for some time; returns the figures of the run."""
    target, found, longest = TARGETS[name], 0, (0.0, b"")
    for data in corpus(name):
        target.check(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    end, runs, most_bytes = time.monotonic() + seconds, 0, 0
    for data in mutated(corpus(name), seed):
        if time.monotonic() > end:
            break
        runs += 1
        most_bytes = max(most_bytes, len(data))
        began = time.perf_counter()
        try:
            target.check(data)
        except Exception as error:
            found += 1
            print(f"{name}: {type(error).__name__}: {str(error)[:200]}", file=sys.stderr)
            _keep(name, data)
        longest = max(longest, (time.perf_counter() - began, data))
    if longest[0] > _SLOW_S:
        _keep(name, longest[1])
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return {
        "target": name,
        "engine": "mutation",
        "executions": runs,
        "seconds": seconds,
        "findings": found,
        "memory_mb": round(grown, 1),
        "longest_ms": round(1000 * longest[0], 1),
        "largest_bytes": most_bytes,
    }


def _keep(name: str, data: bytes) -> None:
    folder = CORPUS / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)


def _guided(name: str, seconds: float) -> None:
    """Let coverage guide; atheris ends the process."""
    import atheris

    target = TARGETS[name]
    functions = (f for found in list(sys.modules.values()) for f in _functions(found, target.modules))
    for module, attribute, function in list(functions):
        with suppress(Exception):  # what cannot be instrumented is run as it is
            setattr(module, attribute, atheris.instrument_func(function))
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-"))
    for k, data in enumerate(corpus(name)):
        (folder / str(k)).write_bytes(data)
    options = [f"-max_total_time={seconds:.0f}", "-print_final_stats=1", "-rss_limit_mb=4096", "-timeout=30"]
    atheris.Setup([sys.argv[0], *options, "-max_len=20000", str(folder)], target.check)
    atheris.Fuzz()


def _functions(module: object, names: tuple[str, ...]) -> list[tuple[object, str, object]]:
    """Functions of a module and of its classes, with where they are kept."""
    if not getattr(module, "__name__", "").startswith(names):
        return []
    found = []
    for holder in (module, *(v for v in vars(module).values() if isinstance(v, type))):
        if getattr(holder, "__module__", module.__name__) != module.__name__:  # type: ignore[attr-defined]
            continue
        found += [(holder, n, f) for n, f in list(vars(holder).items()) if isinstance(f, FunctionType)]
    return found


def main() -> None:
    """Fuzz the targets one after the other, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--guided", action="store_true", help="with atheris")
    parser.add_argument("--here", action="store_true", help="one target in this process")
    options = parser.parse_args()
    if options.here and options.guided:
        _guided(options.targets[0], options.seconds)
    elif options.here:
        print(json.dumps(fuzz(options.targets[0], options.seconds, options.seed)))
    else:
        if options.guided and importlib.util.find_spec("atheris") is None:
            sys.exit("error: pip install atheris")
        how = ["--here", "--seconds", str(options.seconds), "--seed", str(options.seed)]
        how += ["--guided"] if options.guided else []
        for name in options.targets:
            subprocess.run([sys.executable, "-m", "tests.fuzz.run", name, *how], check=False)


if __name__ == "__main__":
    main()
