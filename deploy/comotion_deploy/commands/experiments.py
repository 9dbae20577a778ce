"""``comotion dev reproduce``: the figures of the thesis, and what all experiments say as they run."""

import json
import os
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from ..errors import UserError
from ..options import Assignments, Json, Tool, option, setting


def write_values(path: Path, values: object) -> None:
    """Write results to a JSON file."""
    from comotion_schemas.plain import plain

    path.write_text(json.dumps(plain(values), indent=2) + "\n", encoding="utf-8")


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows what runs next on standard error."""
    from comotion_schemas.terminal import reporting

    with reporting(terminal_s=0.0, plain_s=0.0) as report:
        yield lambda what: report(lambda: what)


class Figures(Assignments, Json, Tool):
    """Draw all figures of the thesis with the thesis method and the default method.

    Writes pictures and a page. Figures 4.6 to 4.11 need the workcell (extra sim3d).
    """

    epilog = """
Examples:
  comotion dev reproduce --quick
  comotion dev reproduce --only 4.4 --only 4.5 --out figures
  comotion dev reproduce figures --only 4.1,4.2 --seeds 0-9 --json
"""
    log_level = "warning"

    only: list[str] | None = option(
        None, "Figure, e.g. 4.4; may be repeated. Default: all fifteen.", metavar="FIGURE"
    )
    seeds: str | None = setting(None, "Seeds of simulated scenes, e.g. 0-4 or 0,3. Default: 0-4, quick 0.")
    workcell_seeds: str | None = option(None, "Seeds of the workcell. Default: 0-1, quick 0.")
    quick: bool = option(False, "One seed each and smaller camera images.")
    cache: Path | None = option(
        None,
        "Folder that keeps tracks for the next run. Default: a folder in ~/.cache/comotion.",
        env="COMOTION_CACHE",
        metavar="DIR",
    )
    out: Path = option(
        Path("figures"), "Where index.html, figures.json and the pictures go.", metavar="DIR", file_okay=False
    )

    def run(self) -> None:
        """Draw them and write the page."""
        import matplotlib  # noqa: F401 - before hours of work

        from comotion_experiments.figures import Options, Study, select
        from comotion_experiments.figures.page import left_out, page
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.tables import Table

        chosen = select(self.only)
        config = self.fusion_config()
        if config.method != "comotion":
            raise UserError(
                f"method {config.method!r}: the figures compare the default method with the thesis'"
            )
        simulated = parse_seeds(self.seeds or ("0" if self.quick else "0-4"))
        filmed = parse_seeds(self.workcell_seeds or ("0" if self.quick else "0-1"))
        workcell = find_spec("mujoco") is not None
        if self.only and not workcell and all(figure.workcell for figure in chosen):
            raise UserError("mujoco is not installed: pip install 'comotion[sim3d]'")
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        cache = self.cache or caches / "comotion" / "figures"
        given = Options(simulated, filmed, self.quick, cache, config)
        with progress() as note:
            study = Study(given, self.out, note)
            study.draw(chosen, workcell=workcell)
        data, html = self.out / "figures.json", self.out / "index.html"
        write_values(data, study.as_json())
        html.write_text(page(study, self._command()), encoding="utf-8")
        missing = [left_out(study)] if left_out(study) else []
        titles = ("figure", "", "the thesis says", "thesis method here", "default method here")
        table = Table(titles, words=len(titles))
        for figure, drawn in study.made:
            for k, row in enumerate(drawn.rows):
                table.add(figure.name if k == 0 else "", row.quantity, row.printed, row.thesis, row.default)
            table.end_section()
        self.show(study.as_json(), table, *missing, f"written: {html}, {data}", width=170)

    def _command(self) -> str:
        """Return the command line that makes the same page."""
        words = ["comotion", "dev", "reproduce"]
        for name in self.only or ():
            words += ["--only", name]
        for flag, value in (("--seeds", self.seeds), ("--workcell-seeds", self.workcell_seeds)):
            words += [flag, value] if value else []
        words += ["--quick"] if self.quick else []
        for assignment in self.set_ or ():
            words += ["--set", assignment]
        return shlex.join(words)
