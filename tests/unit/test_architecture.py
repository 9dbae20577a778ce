"""docs/architecture.md names every file and folder once; what is heavy is imported where it is used."""

import re
import subprocess
import sys
from pathlib import Path

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


ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SECTIONS = re.findall(r"^### `(\S+)`\n(.*?)(?=^##)", PAGE, re.MULTILINE | re.DOTALL)
UNNAMED = {"__init__.py", "__main__.py", "py.typed", "__pycache__"}


def named(section: str) -> list[str]:
    """Files, folders (with a slash) and patterns in the first column of the table."""
    rows = re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
    return [name for row in rows for name in re.findall(r"`(\S+)`", row)]


def children(folder: Path) -> list[str]:
    """Modules and folders in a package, as the page names them."""
    present = [path for path in folder.iterdir() if path.name not in UNNAMED]
    # A folder that git does not know may hold nothing but compiled files.
    return [f"{path.name}/" if path.is_dir() else path.name for path in present if any_file(path)]


def any_file(path: Path) -> bool:
    return path.is_file() or any(p.is_file() and p.suffix != ".pyc" for p in path.rglob("*"))


def test_every_package_has_its_table() -> None:
    packages = {str(path.parent.relative_to(ROOT)) for path in ROOT.glob("[!t]*/comotion*/__init__.py")}
    assert {folder for folder, _ in SECTIONS} == packages


@pytest.mark.parametrize(("folder", "section"), SECTIONS, ids=[folder for folder, _ in SECTIONS])
def test_each_file_is_in_one_row_and_each_row_names_what_is_there(folder: str, section: str) -> None:
    names, present = named(section), children(ROOT / folder)
    for child in present:
        matching = [name for name in names if Path(child).match(name.rstrip("/"))]
        assert len(matching) == 1, f"{folder}/{child} is in {len(matching)} rows of docs/architecture.md"
    for name in names:
        assert any(Path(child).match(name.rstrip("/")) for child in present), f"{folder} has no {name}"
