"""Compiled kernels: kept on disk by all of their sources, and compiled ahead by processes."""

import ast
import importlib
import os
import pickle
import pkgutil
import shutil
import subprocess
import sys
from functools import cache
from importlib.util import find_spec, resolve_name
from pathlib import Path
from types import CodeType

import pytest

import comotion
from comotion import compiled, warm_up
from comotion.warm_up import compile_ahead

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

    def __init__(self, root):
        self.root, self.home = root / "package", root / "home"
        for folder, source in (("first", INNER), ("second", OUTER)):
            (self.root / folder).mkdir(parents=True)
            (self.root / folder / "__init__.py").touch()
            (self.root / folder / "kernels.py").write_text(source)
        (self.root / "__init__.py").touch()
        shutil.copy(str(compiled.__file__), self.root)

    def run(self):
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

    def files(self):
        """What is kept of the kernels."""
        return set(self.root.rglob("*.nb[ic]"))

    def change_callee(self):
        """Change the inner kernel, and nothing else that a file system could tell."""
        file = self.root / "first" / "kernels.py"
        before = file.stat()
        file.write_text(INNER.replace("2 * x", "5 * x"))
        os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
        assert file.stat().st_size == before.st_size


@pytest.fixture
def package(tmp_path):
    return Package(tmp_path)


def test_a_changed_callee_is_compiled_anew_and_an_unchanged_one_is_loaded(package):
    assert package.run() == (7, 0, 1)
    before = package.files()
    assert package.run() == (7, 1, 0)
    package.change_callee()
    assert package.run() == (16, 0, 1)
    assert package.run() == (16, 1, 0)
    # What nobody reads any more is removed.
    assert len(package.files()) == len(before) > 0
    assert not package.files() & before


def test_without_a_writable_package_the_users_cache_serves_and_without_any_each_process_compiles(package):
    (package.root / "__pycache__").touch()
    assert package.run() == (7, 0, 1)
    assert package.run() == (7, 1, 0)
    shutil.rmtree(package.home)
    package.home.touch()
    assert package.run() == (7, 0, 1)
    assert package.run() == (7, 0, 1)


def names(code):
    inside = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*(names(part) for part in inside))


@cache
def imported(module):
    """Names that a module imports from elsewhere in the package, and from which of its modules."""
    tree = ast.parse(Path(str(module.__file__)).read_text())
    return {
        alias.asname or alias.name: resolve_name("." * node.level + (node.module or ""), module.__package__)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    }


def test_kernels_use_nothing_of_the_package_that_the_digest_does_not_cover():
    for module in pkgutil.walk_packages(comotion.__path__, "comotion."):
        importlib.import_module(module.name)
    covered = {str(path) for path in compiled.kernel_sources()}
    for kernel in compiled.KERNELS:
        module = kernel.py_func.__module__
        origins = imported(sys.modules[module])
        assert kernel._cache.cache_path.startswith(str(compiled.folder()))
        for name in names(kernel.py_func.__code__) & origins.keys():
            file = find_spec(origins[name]).origin  # type: ignore[union-attr]
            assert file in covered, f"{name} in {module} is from {file}"
    assert len(compiled.KERNELS) > 50


@pytest.mark.parametrize("python", [sys.executable, "/bin/false", "/missing"])
def test_what_processes_have_compiled_is_compiled_once_and_where_they_die_nothing_is(
    monkeypatch, tmp_path, python
):
    monkeypatch.setattr(warm_up, "folder", lambda: tmp_path)
    monkeypatch.setattr(warm_up, "_start", lambda method, kinds: subprocess.Popen([python, "-c", "pass"]))
    given = [("comotion", [("m", 3), ("px", 2)]), ("comotion", [("m", 2)]), ("thesis", [("m", 3)])]
    first, again = ([bool(list(compile_ahead(*one))) for one in given] for _ in range(2))
    assert python != sys.executable or (first, again) == ([True] * 3, [False] * 3)
    assert bool(list(tmp_path.iterdir())) == (python == sys.executable)


@pytest.mark.parametrize("content", [b"", pickle.dumps([("comotion.rigid.kernels", "fit", ())])[:-9]])
def test_notes_that_were_cut_off_count_as_none(tmp_path, content):
    (tmp_path / "noted").write_bytes(content)
    assert warm_up._read(tmp_path / "noted") is warm_up._read(tmp_path / "missing") is None
