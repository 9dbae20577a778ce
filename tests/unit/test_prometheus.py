"""Metrics are free when nobody asks for them; what they tell otherwise is tested with real processes."""

import subprocess
import sys

import pytest

from comotion_schemas import metrics


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
