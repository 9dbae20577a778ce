"""Compiled kernels on disk: kept by all of their sources, wherever there is a folder to keep them in."""

import ast
import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec, resolve_name
from pathlib import Path
from types import CodeType, ModuleType

import pytest
from numba.core.dispatcher import Dispatcher

import comotion
from comotion import compiled, kernel_cache

from ..reference.every_kernel import SCENES

EVERY_KERNEL = Path(__file__).parents[1] / "reference" / "every_kernel.py"

INNER = """
from ..compiled import compiled

@compiled()
def inner(x):
    return 2 * x
"""
OUTER = """
from ..compiled import compiled
from ..first.kernels import inner

@compiled()
def outer(x):
    return inner(x) + 1

def run():
    print(outer(3), sum(outer.stats.cache_hits.values()), sum(outer.stats.cache_misses.values()))
"""


class Package:
    """A package of two folders with a kernel each; that of the second calls that of the first."""

    def __init__(self, root: Path) -> None:
        self.root, self.home = root / "package", root / "home"
        for folder, source in (("first", INNER), ("second", OUTER)):
            (self.root / folder).mkdir(parents=True)
            (self.root / folder / "__init__.py").touch()
            (self.root / folder / "kernels.py").write_text(source)
        (self.root / "__init__.py").touch()
        for module in (compiled, kernel_cache):
            shutil.copy(str(module.__file__), self.root)

    def run(self) -> tuple[int, int, int]:
        """Result of the outer kernel in a process of its own; how often it was loaded, and compiled."""
        env = {**os.environ, "PYTHONPATH": str(self.root.parent), "XDG_CACHE_HOME": str(self.home)}
        env.pop("NUMBA_CACHE_DIR", None)
        code = "from package.second.kernels import run; run()"
        done = subprocess.run(
            [sys.executable, "-B", "-c", code], check=False, env=env, capture_output=True, text=True
        )
        assert not done.returncode, done.stderr
        result, loaded, built = map(int, done.stdout.split())
        return result, loaded, built

    def files(self) -> set[Path]:
        """What is kept of the kernels."""
        return set(self.root.rglob("*.nb[ic]"))

    def change_callee(self) -> None:
        """Change the inner kernel, and nothing else that a file system could tell."""
        file = self.root / "first" / "kernels.py"
        before = file.stat()
        file.write_text(INNER.replace("2 * x", "5 * x"))
        os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
        assert file.stat().st_size == before.st_size


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path)


def test_a_changed_callee_is_compiled_anew_and_an_unchanged_one_is_loaded(package: Package) -> None:
    assert package.run() == (7, 0, 1)
    before = package.files()
    assert package.run() == (7, 1, 0)
    package.change_callee()
    assert package.run() == (16, 0, 1)
    assert package.run() == (16, 1, 0)
    # What nobody reads any more is removed.
    assert len(package.files()) == len(before) > 0
    assert not package.files() & before


def test_a_kernel_can_be_compiled_with_a_callee_that_was_loaded(package: Package) -> None:
    package.run()
    for file in package.files():
        if file.name.startswith("kernels.outer"):
            file.unlink()
    assert package.run() == (7, 0, 1)
    assert package.run() == (7, 1, 0)


def test_without_a_writable_package_the_users_cache_serves_and_without_any_each_process_compiles(
    package: Package,
) -> None:
    for folder in ("first", "second"):
        (package.root / folder / "__pycache__").touch()
    assert package.run() == (7, 0, 1)
    assert package.run() == (7, 1, 0)
    shutil.rmtree(package.home)
    package.home.touch()
    assert package.run() == (7, 0, 1)
    assert package.run() == (7, 0, 1)


def updates(
    threads: int, scenes: Sequence[str] = tuple(SCENES), folder: Path | None = None
) -> tuple[dict[str, str], int]:
    """Digests of the updates of scenes in a process of its own, and how many kernels it loaded."""
    env = {**os.environ, "NUMBA_NUM_THREADS": str(threads)}
    if folder:
        env["NUMBA_CACHE_DIR"] = str(folder)
    command = [sys.executable, str(EVERY_KERNEL), *scenes]
    answer = subprocess.run(command, check=True, env=env, stdout=subprocess.PIPE, text=True).stdout
    *digests, loaded = answer.split()
    return dict(zip(scenes, digests, strict=True)), int(loaded)


@pytest.mark.timeout(900)  # compiles
def test_processes_that_compile_and_that_load_give_the_same_updates_with_any_number_of_threads(
    digests_before: tuple[dict[str, str], bool], tmp_path: Path
) -> None:
    before, compiled_before = digests_before
    before = before or updates(2)[0]
    # Where set-up has compiled everything, what takes the shortest is compiled again.
    anew = [] if compiled_before else ["thesis"]
    found, loaded = updates(1, [scene for scene in SCENES if scene not in anew])
    assert loaded > 50
    if anew:
        found |= updates(1, anew, tmp_path)[0]
    assert found == before


def modules() -> Iterator[ModuleType]:
    for found in pkgutil.walk_packages(comotion.__path__, "comotion."):
        yield importlib.import_module(found.name)


def names(code: CodeType) -> set[str]:
    inside = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*(names(part) for part in inside))


def imported(module: ModuleType) -> dict[str, str]:
    """Names that a module imports from elsewhere in the package, and from which of its modules."""
    tree = ast.parse(Path(str(module.__file__)).read_text())
    return {
        alias.asname or alias.name: resolve_name("." * node.level + (node.module or ""), module.__package__)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    }


def test_kernels_use_nothing_of_the_package_that_the_digest_does_not_cover() -> None:
    found = 0
    outside = set()
    covered = {str(path) for path in kernel_cache.kernel_sources()}
    for module in modules():
        origins = imported(module)
        for kernel in vars(module).values():
            if not isinstance(kernel, Dispatcher) or kernel.py_func.__module__ != module.__name__:
                continue
            found += 1
            assert isinstance(kernel._cache, kernel_cache.KernelCache)
            for name in names(kernel.py_func.__code__) & origins.keys():
                file = find_spec(origins[name]).origin  # type: ignore[union-attr]
                if file not in covered:
                    outside.add(f"{name} in {module.__name__} is from {file}")
    assert not outside
    assert found > 50


@pytest.mark.parametrize("method", ["comotion", "thesis"])
@pytest.mark.timeout(900)  # compiles what has changed
def test_after_ready_nothing_is_compiled_or_loaded_whatever_comes_first(method: str) -> None:
    """Signatures are counted, so it does not matter what is on the disk; CI starts from an empty folder."""
    script = EVERY_KERNEL.with_name("first_tick.py")
    done = subprocess.run(
        [sys.executable, str(script), method], check=True, stdout=subprocess.PIPE, text=True
    )
    assert done.stdout == ""
