"""Each script attacks a running scene, see :mod:`.arena`; ``make test-long`` runs them."""

from contextlib import ExitStack

import pytest

from .arena import Arena

BUSY = 2.0
"""Load of the machine beyond which the bound on gaps does not hold."""


@pytest.fixture
def enter(tmp_path):
    """Start a scene: ``enter(held=True)``."""
    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(Arena(tmp_path, **options))
