"""The code in README and docs runs, and the commands in them exist."""

import re
import shlex
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from comotion_clients.subscribe import subscribe
from comotion_deploy.cli import run

pytestmark = pytest.mark.e2e
ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for number, (found, text) in enumerate(BLOCK.findall(page.read_text())):
            if found == language:
                yield f"{page.name}:{number}", text


PYTHON = dict(blocks("python"))
PUBLISHERS = [name for name, text in PYTHON.items() if "Publisher(" in text or "declare_publisher" in text]
SUBSCRIBERS = [name for name, text in PYTHON.items() if "subscribe(" in text]
SCRIPTS = [name for name in PYTHON if name not in PUBLISHERS and name not in SUBSCRIBERS]


@pytest.fixture
def run_block(endpoint: str, tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Start a block of Python as a user would: pasted into a file."""
    running: list[subprocess.Popen[str]] = []

    def begin(name: str) -> subprocess.Popen[str]:
        script = tmp_path / f"block{len(running)}.py"
        script.write_text(PYTHON[name].replace(DEFAULT_ENDPOINT, endpoint))
        process = subprocess.Popen(
            [sys.executable, "-u", "-W", "error", str(script)], stdout=subprocess.PIPE, text=True
        )
        running.append(process)
        return process

    yield begin
    for process in running:
        process.kill()
        process.communicate()


def test_there_is_code_of_every_kind() -> None:
    assert len(PUBLISHERS) >= 2
    assert SUBSCRIBERS
    assert SCRIPTS


def test_publishing_takes_twenty_lines() -> None:
    (readme,) = [name for name in PUBLISHERS if name.startswith("README")]
    assert len([line for line in PYTHON[readme].splitlines() if line.strip()]) <= 20


@pytest.mark.parametrize("name", PUBLISHERS)
def test_code_that_publishes(name: str, start: Callable, endpoint: str, run_block: Callable) -> None:
    start("serve", "--connect", endpoint)
    run_block(name)
    with subscribe("default", endpoint, timeout=30) as updates:
        # The box and the floor part; else the time limit of the test strikes.
        next(update for update in updates if sorted(h.size for h in update.hypotheses) == [10, 20])


@pytest.mark.parametrize("name", SUBSCRIBERS)
def test_code_that_subscribes(name: str, start: Callable, endpoint: str, run_block: Callable) -> None:
    start("serve", "--connect", endpoint)
    start("source", "simulator", "fig4_1", "--loop", "--connect", endpoint)
    process = run_block(name)
    alarm = threading.Timer(30, process.kill)
    alarm.start()
    line = process.stdout.readline()
    alarm.cancel()
    assert re.match(r"\d+ (moving|undetermined|static) \[", line)


@pytest.mark.parametrize("name", SCRIPTS)
def test_code_that_runs_to_its_end(name: str, run_block: Callable) -> None:
    process = run_block(name)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert output.strip()


def commands() -> Iterator[list[str]]:
    """Every `comotion` command line of the pages, in blocks and in running text."""
    for page in PAGES:
        text = page.read_text()
        lines = [
            line
            for language, block in BLOCK.findall(text)
            if language == "bash"
            for line in block.splitlines()
        ]
        lines += re.findall(r"`(comotion [^`]+)`", BLOCK.sub("", text))
        for line in lines:
            words = shlex.split(line, comments=True)
            if words[:1] == ["comotion"]:
                yield words[1:]


COMMANDS = sorted({shlex.join(words) for words in commands()})


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_exist_with_their_options(
    line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    words = shlex.split(line)
    chosen = words[:2] if words[0] in {"source", "reproduce"} else words[:1]
    assert run([*chosen, "--help"]) == 0
    text = capsys.readouterr().out
    for option in (word for word in words if word.startswith("--")):
        assert re.search(rf"{option}\b", text), option


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_pictures_are_small() -> None:
    for picture in (ROOT / "docs" / "images").iterdir():
        assert picture.stat().st_size < 300_000, picture.name
