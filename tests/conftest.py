"""How the suite is spread over cores."""

from pathlib import Path

import pytest

_E2E = Path(__file__).parent / "e2e"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of real processes run one after another, beside the others: at once they starve each other."""
    for item in items:
        if item.path.is_relative_to(_E2E):
            item.add_marker(pytest.mark.xdist_group("e2e"))
