"""Commands as a user gives them, in the process of the test."""

import pytest

from comotion_deploy.cli import run


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What a command says that cannot be right: one line, nothing else, and status 2."""
    assert run(list(map(str, arguments))) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("error: ")
    return line
