"""How the suite is spread over cores, and the kernels compiled before."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

_E2E = Path(__file__).parent / "e2e"
_EVERY_KERNEL = Path(__file__).parent / "reference" / "every_kernel.py"
_DIGESTS = pytest.StashKey[list[str] | None]()
_TO_WORKERS = "comotion_digests"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of real processes run one after another, beside the others: at once they starve each other."""
    for item in items:
        if item.path.is_relative_to(_E2E):
            item.add_marker(pytest.mark.xdist_group("e2e"))
            # Several waits of one test may be long on a loaded machine; each has a deadline of its own.
            item.add_marker(pytest.mark.timeout(600))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Compile once for all workers: at the same time each would compile every kernel."""
    _compile(config)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile before any deadline of a process under test runs."""
    runs = not session.config.option.collectonly
    if runs and any("start" in getattr(item, "fixturenames", ()) for item in session.items):
        _compile(session.config)


def _compile(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        return
    config.get_terminal_writer().line("compiling what has changed: up to two minutes")
    command = [sys.executable, str(_EVERY_KERNEL)]
    done = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
    *digests, loaded = done.stdout.split() or ["failed"]
    config.stash[_DIGESTS] = digests if loaded == "0" else None


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Services under test keep their state in a folder of the test run, not in the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput[_TO_WORKERS] = node.config.stash[_DIGESTS]


@pytest.fixture(scope="session")
def digests_when_compiled(pytestconfig: pytest.Config) -> list[str] | None:
    """What the process printed that compiled all kernels for this run; None if it found some on disk."""
    given = getattr(pytestconfig, "workerinput", {}).get(_TO_WORKERS)
    return given or pytestconfig.stash.get(_DIGESTS, None)
