"""How the suite is spread over cores, and the kernels compiled before."""

import gc
import os
import subprocess
import sys
from collections.abc import Generator, Iterator
from typing import Any

import pytest
from hypothesis import settings

# The same examples on every run, so that a change is what makes a test fail; others are drawn with
# pytest --hypothesis-profile=random. A loaded machine fails no example for its time.
settings.register_profile("repeated", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile("repeated")

# Folders whose modules run one after another: more processes at once starve each other.
_ONE_BY_ONE = ("tests/e2e/services/", "tests/e2e/")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import without looking for garbage: what is imported stays, and a third of the time went there."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep a module on one worker, which starts what its tests share once.

    Groups of xdist itself are marks, which it loses with pytest 9.2.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByFolder(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.partition("::")[0]
            return next((folder for folder in _ONE_BY_ONE if module.startswith(folder)), module)

    return ByFolder(config, log)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Compile once for all workers: at the same time each would compile every kernel."""
    _compile()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile before any deadline of a process under test runs."""
    alone = "PYTEST_XDIST_WORKER" not in os.environ and not session.config.option.collectonly
    if alone and any(item.get_closest_marker("e2e") for item in session.items):
        _compile()


def _compile() -> None:
    command = [sys.executable, "-m", "comotion_deploy", "dev", "warm-up"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=env)


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Services under test keep their state in a folder of the test run, not in the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
