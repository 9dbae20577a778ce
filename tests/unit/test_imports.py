"""What is imported, and when: what is heavy or an extra only where it is used."""

import subprocess
import sys

import pytest

import comotion

SCRIPTS = {
    "help": (
        "from comotion_deploy.cli import run; run(['--help'])",
        ("numpy", "zenoh", "sklearn", "scipy", "pydantic.dataclasses", "comotion", "comotion_schemas"),
    ),
    "messages": ("import comotion_schemas", ("zenoh",)),
    "configuration": ("from comotion import FusionConfig; FusionConfig()", ("numba",)),
    "processes without metrics": (
        "import comotion.runtime.server, comotion_sources.runtime; from comotion_schemas import metrics;"
        "assert metrics.histogram('tick_seconds', scene='a', component='b', role='service') is metrics.off",
        ("prometheus_client",),
    ),
}


@pytest.mark.parametrize(("script", "absent"), SCRIPTS.values(), ids=SCRIPTS)
def test_what_is_heavy_is_not_imported_for(script: str, absent: tuple[str, ...]) -> None:
    code = f"{script}\nimport sys\nprint(sorted(set(sys.modules) & set({absent!r})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_all_of_the_core_is_imported_at_its_first_use() -> None:
    assert set(comotion.__all__) <= set(dir(comotion))
    assert all(hasattr(comotion, name) for name in comotion.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        comotion.nothing  # noqa: B018
