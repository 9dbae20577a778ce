"""Metrics are free when nobody asks for them; what they tell otherwise is tested with real processes."""

import subprocess
import sys

import pytest

from comotion_schemas import metrics

from ..command_line import refused


def test_nothing_is_counted_or_imported_unless_asked_for() -> None:
    script = (
        "import sys; import comotion.runtime.server, comotion_sources.runtime;"
        "from comotion_schemas import metrics;"
        "assert metrics.histogram('tick_seconds', scene='a', component='b', role='service') is metrics.OFF;"
        "print('prometheus_client' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


@pytest.mark.parametrize(
    ("text", "address"),
    [("9464", ("127.0.0.1", 9464)), ("0.0.0.0:1", ("0.0.0.0", 1)), ("localhost:0", ("localhost", 0))],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert metrics.parse_address(text) == address


@pytest.mark.parametrize("text", ["", "x", ":1", "1:", "a:b", "70000", "-1"])
def test_what_is_no_address_is_one_clear_line(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "serve", f"--metrics-port={text}")
    assert line == f"error: metrics port {text!r} is neither PORT nor HOST:PORT"
