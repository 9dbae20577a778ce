"""The code in README and docs runs, and the commands in them exist.

A comment before a block says what is to be done with it; it does not show on the page:

``<!-- file: NAME -->``
    Write it to a file of this name, for the commands that follow.
``<!-- start -->``
    Start each `comotion` command of the block and wait until it is ready; the router and the service
    are those that all tests here share.
``<!-- run -->``
    Run each line to its end.

Blocks of Python without one are run by what they do; of every other `comotion` command it is checked
that it takes these arguments.
"""

import itertools
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

from comotion_clients.subscribe import subscribe
from comotion_deploy.cli import app, run
from comotion_deploy.processes import read_processes
from comotion_tools.parameter_table import filled

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
BLOCK = re.compile(r"^(?:<!-- (\w+)(?:: (\S+))? -->\n)?```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RUN_S = 300


class Block(NamedTuple):
    """A block of code and the comment before it."""

    name: str
    mark: str
    argument: str
    language: str
    text: str

    @property
    def lines(self) -> list[list[str]]:
        """Words of each line, comments left out."""
        return [words for line in self.text.splitlines() if (words := shlex.split(line, comments=True))]


def blocks(page: Path) -> list[Block]:
    matches = BLOCK.findall(page.read_text())
    return [Block(f"{page.relative_to(ROOT)}:{number}", *block) for number, block in enumerate(matches)]


ALL = [block for page in PAGES for block in blocks(page)]
PYTHON = {block.name: block.text for block in ALL if block.language == "python" and not block.mark}
PUBLISHERS = [name for name, text in PYTHON.items() if "Publisher(" in text or "declare_publisher" in text]
SUBSCRIBERS = [name for name, text in PYTHON.items() if "subscribe(" in text]
SCRIPTS = [name for name in PYTHON if name not in PUBLISHERS and name not in SUBSCRIBERS]
SESSIONS = [page for page in PAGES if any(block.mark in {"start", "run"} for block in blocks(page))]


@pytest.fixture(scope="module")
def endpoint(start_shared, shared_endpoint):
    """Endpoint of a running system: a router and a service."""
    start_shared("router", "--listen", shared_endpoint)
    start_shared("serve", "--connect", shared_endpoint)
    return shared_endpoint


@pytest.fixture
def run_block(endpoint, tmp_path, start):
    """Start a block of Python as a user would: pasted into a file."""

    def begin(name):
        script = tmp_path / "block.py"
        script.write_text(PYTHON[name].replace(DEFAULT_ENDPOINT, endpoint))
        return start.any(sys.executable, "-W", "error", script, cwd=tmp_path)

    return begin


def quietly(words: Sequence[str | Path], **how: Any) -> subprocess.CompletedProcess[str]:
    """Run a command, keeping what it prints."""
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=RUN_S, **how)


@contextmanager
def box_and_floor_are_told_apart(endpoint: str) -> Iterator[None]:
    """Wait for the features of a source that is not there yet; else the time limit of the test strikes."""
    with subscribe("default", endpoint, timeout=RUN_S) as updates:
        before = {source.session for source in next(updates).sources}
        yield
        for update in updates:
            new = {source.session for source in update.sources}.isdisjoint(before)
            # Bodies of earlier sources are remembered for a minute.
            if new and sorted(h.size for h in update.hypotheses if not h.absent) == [10, 20]:
                return


def test_there_is_code_of_every_kind():
    assert len(PUBLISHERS) >= 3
    assert SUBSCRIBERS
    assert SCRIPTS
    assert len(SESSIONS) >= 2
    # A comment that is misspelt would leave its block out.
    assert {block.mark for block in ALL} == {"", "file", "start", "run"}


def test_publishing_takes_twenty_lines():
    (readme,) = [name for name in PUBLISHERS if name.startswith("README")]
    assert len([line for line in PYTHON[readme].splitlines() if line.strip()]) <= 20


@pytest.mark.parametrize("name", PUBLISHERS)
def test_code_that_publishes(name, endpoint, run_block):
    with box_and_floor_are_told_apart(endpoint):
        run_block(name)


@pytest.mark.parametrize(
    "command", ["cc -O2 -std=c11 -Wall -Wextra -Werror tracker.c -lm", "rustc -O tracker.rs"]
)
def test_sources_in_other_languages(command, endpoint, start, tmp_path):
    words = command.split()
    if shutil.which(words[0]) is None:
        pytest.skip(f"no {words[0]}")
    examples, tracker = ROOT / "docs" / "examples", tmp_path / "tracker"
    subprocess.run([*words, "-o", tracker], cwd=examples, check=True, timeout=RUN_S)
    (pipe,) = [block for block in ALL if block.argument == "pipe.py"]
    (tmp_path / "pipe.py").write_text(pipe.text)
    with box_and_floor_are_told_apart(endpoint):
        start.any(sys.executable, "-W", "error", "pipe.py", endpoint, tracker, cwd=tmp_path)


@pytest.mark.parametrize("name", SUBSCRIBERS)
def test_code_that_subscribes(name, start, endpoint, run_block):
    start("source", "simulator", "fig4_1", "--loop", "--connect", endpoint)
    run_block(name).wait_line(lambda line: re.match(r"\d+ (moving|undetermined|static) \[", line))


@pytest.mark.parametrize("name", SCRIPTS)
def test_code_that_runs_to_its_end(name, tmp_path, monkeypatch, capsys):
    script = tmp_path / "block.py"
    script.write_text(PYTHON[name])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out.strip()


@pytest.mark.parametrize("page", SESSIONS, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_can_be_followed(page, start, endpoint, tmp_path):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "COMOTION_CONNECT": endpoint, "PATH": path}
    for block in blocks(page):
        if block.mark == "file":
            (tmp_path / block.argument).write_text(block.text.replace(DEFAULT_ENDPOINT, endpoint))
        for words in block.lines if block.mark == "start" else []:
            assert words[0] == "comotion", words
            if words[1] not in {"router", "serve"}:
                start(*words[1:], "--connect", endpoint, cwd=tmp_path)
        for words in block.lines if block.mark == "run" else []:
            done = quietly(words, cwd=tmp_path, env=env)
            assert done.returncode == 0, f"{shlex.join(words)}: {done.stdout}{done.stderr}"
            assert done.stdout.strip(), words


@pytest.mark.parametrize(
    "block", [block for block in ALL if block.argument.endswith(".toml")], ids=lambda block: block.name
)
def test_configuration_files_are_valid(block, tmp_path, capsys):
    file = tmp_path / block.argument
    file.write_text(block.text)
    assert run(["config", "--config", str(file)]) == 0
    assert capsys.readouterr().out
    content = tomllib.loads(block.text)
    for spec in read_processes(content) if "process" in content else []:
        words = spec.command[spec.command.index("comotion_deploy") + 1 :]
        assert run([*words, "--config", str(file), "--help"]) == 0


def commands() -> Iterator[list[str]]:
    """Every `comotion` command line of the pages, in blocks and in running text."""
    for block in ALL:
        if block.language == "bash":
            # A command may stand behind others: sudo, taskset -c 2, ...
            yield from (own_words(words) for words in block.lines if "comotion" in words)
    for page in PAGES:
        inline = re.findall(r"`([^`]+)`", BLOCK.sub("", page.read_text()))
        for words in (shlex.split(text) for text in inline if re.search(r"(^| )comotion ", text)):
            yield own_words(words)


def examples() -> Iterator[list[str]]:
    """Every example in the help of a command; each command has some."""
    commands = [typer.main.get_command(app)]
    for command in commands:
        children = getattr(command, "commands", {}).values()
        commands += children
        lines = [line for line in (command.epilog or "").splitlines() if line.startswith("  comotion ")]
        assert lines or children, command.name
        yield from (own_words(shlex.split(line, comments=True)) for line in lines)


def own_words(words: list[str]) -> list[str]:
    """The words of `comotion` in a line of shell: none before it, none that the shell takes."""
    words = words[words.index("comotion") :]
    return list(itertools.takewhile(lambda word: word not in {">", "|", "&", "&&", "..."}, words))


COMMANDS = sorted({shlex.join(words[1:]) for words in itertools.chain(commands(), examples())} - {""})


@pytest.fixture(scope="module")
def program():
    """The command line, each command of which takes its arguments and does nothing."""
    commands = [typer.main.get_command(app)]
    for command in commands:
        commands += getattr(command, "commands", {}).values()
        if not hasattr(command, "commands") or command.invoke_without_command:
            command.callback = lambda **_: None
    return commands[0]


@pytest.fixture(scope="module")
def folder_of_files(tmp_path_factory):
    """Holds the files of the pages."""
    folder = tmp_path_factory.mktemp("files")
    for block in ALL:
        if block.mark == "file":
            (folder / block.argument).write_text(block.text)
    return folder


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_take_these_arguments(line, program, folder_of_files, monkeypatch):
    monkeypatch.chdir(folder_of_files)
    words = shlex.split(line)
    leaf, depth = program, 0
    while depth < len(words) and words[depth] in getattr(leaf, "commands", {}):
        leaf = leaf.commands[words[depth]]
        depth += 1
    # A mere name, in running text, need not have the arguments that the command requires.
    if depth == 0 or depth < len(words):
        assert program.main(words, prog_name="comotion", standalone_mode=False) in {None, 0}


def test_the_tables_of_parameters_are_in_step():
    page = (ROOT / "docs" / "parameters.md").read_text()
    assert filled(page) == page, "run: python -m comotion_tools.parameter_table docs/parameters.md"


def test_every_page_is_in_the_index():
    folder = ROOT / "docs"
    index = (folder / "README.md").read_text()
    for page in folder.rglob("*.md"):
        assert page.name == "README.md" or f"]({page.relative_to(folder)})" in index, page


def test_links_lead_somewhere():
    for page in PAGES:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)", page.read_text()):
            if target.startswith("http"):
                continue
            goal = (page.parent / target) if target else page
            assert goal.exists(), f"{page}: {target}"
            if anchor:
                assert anchor in anchors(goal), f"{page}: {target}#{anchor}"


def anchors(page: Path) -> set[str]:
    """Where a link can lead within a page, as GitHub names its headings."""
    headings = re.findall(r"^#+ (.+)$", BLOCK.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_units_are_valid(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd")
    for unit in (ROOT / "deploy" / "systemd").iterdir():
        # Neither the program nor its user is there.
        text = unit.read_text().replace("/opt/comotion/.venv/bin/comotion", "/bin/true")
        (tmp_path / unit.name.replace("@", "@cell")).write_text(text.replace("User=comotion", "User=root"))
    units = sorted(tmp_path.iterdir())
    done = quietly(["systemd-analyze", "verify", *units])
    ours = [line for line in done.stderr.splitlines() if any(unit.name in line for unit in units)]
    assert not ours
