"""The page of all figures, one HTML file that needs no other."""

import base64
import json
import platform
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import metadata, resources
from pathlib import Path

from .study import Drawn, Figure, Study, summary

_PACKAGES = ("comotion", "numpy", "scipy", "scikit-learn", "numba", "opencv-python-headless")
_OF_EXTRAS = ("mujoco", "matplotlib")
_MEANS = """Mean over updates and, after ±, the standard deviation over seeds. The thesis method's parameters
are the best of those drawn, chosen in hindsight; the default method has its defaults everywhere. In figure
4.3 nothing moves for 10 of 12.67 s: nothing can score above 0 until then."""


def page(study: Study, command: str) -> str:
    """Compose the page of a study, whose pictures are embedded; `command` is what makes it again."""
    missing = left_out(study)
    versions = [("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}")]
    for name in (*_PACKAGES, *_OF_EXTRAS):
        try:
            versions.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            versions.append((name, "not installed"))
    parts = {
        "command": escape(command),
        "notice": f'<p class="notice">{escape(missing[0].upper() + missing[1:])}.</p>' if missing else "",
        "summary": _summary(study),
        "links": " · ".join(_link(figure) for figure, _ in study.made),
        "figures": "\n".join(_section(figure, drawn, study.out) for figure, drawn in study.made),
        "config": escape(json.dumps(study.options.default.model_dump(mode="json"), indent=2)),
        "versions": _table(("", ""), [tuple(map(escape, version)) for version in versions]),
    }
    template = (resources.files(__package__) / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{(\w+)\}", lambda name: parts[name[1]], template)


def left_out(study: Study) -> str:
    """One line about the figures that were left out; empty when none was."""
    names = [figure.name for figure in study.left_out]
    if not names:
        return ""
    which = f"figure {names[0]} is" if len(names) == 1 else f"figures {', '.join(names)} are"
    return f"{which} left out; they need the workcell: pip install 'comotion[sim3d]'"


def _summary(study: Study) -> str:
    rows = [
        (_link(figure), *(escape(text) for text in (figure.title, *summary(drawn.curves))))
        for figure, drawn in study.made
        if drawn.curves
    ]
    if not rows:
        return ""
    head = ("figure", "", "mean NMI, thesis method at its best", "mean NMI, default method")
    return f"{_table(head, rows)}<p>{_MEANS}</p>"


def _link(figure: Figure) -> str:
    return f'<a href="#{figure.anchor}">{escape(figure.name)}</a>'


def _section(figure: Figure, drawn: Drawn, folder: Path) -> str:
    image = base64.b64encode((folder / figure.file).read_bytes()).decode("ascii")
    parameters = [f"<b>{escape(name)}</b> {escape(text)}" for name, text in drawn.parameters.items()]
    rows = [tuple(map(escape, (row.quantity, row.printed, row.thesis, row.default))) for row in drawn.rows]
    return (
        f'<h2 id="{figure.anchor}"><span class="no">{escape(figure.name)}</span>{escape(figure.title)}</h2>\n'
        f"<p>{escape(figure.shows)}</p>\n"
        f'<img alt="{escape(figure.title)}" src="data:image/png;base64,{image}">\n'
        + _table(("", "the thesis says", "thesis method here", "default method here"), rows)
        + f'<p class="with">{" · ".join(parameters)}</p>'
    )


def _table(head: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    titles = "".join(f"<th>{title}</th>" for title in head)
    top = f"<tr>{titles}</tr>" if titles.replace("<th></th>", "") else ""
    lines = "".join("<tr>" + "".join(f'<td class="number">{c}</td>' for c in row) + "</tr>" for row in rows)
    return f"<table>{top}{lines}</table>"
