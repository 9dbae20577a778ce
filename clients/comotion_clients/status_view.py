"""SceneStatus -> tables for a terminal. Pure; given texts are no markup."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from .scene_problems import ComponentRow
from .scene_status import SceneStatus

_STYLES = {"ok": "green", "degraded": "yellow", "stalled": "red", "silent": "red"}


def show(found: SceneStatus, console: Console) -> None:
    """Print a scene's status: what to look at, a table of components, and one of routers."""
    line = Text.assemble(f"scene {found.scene}: ", (found.overall, _STYLES[found.overall]))
    if found.updates_hz is not None and found.update_lag_s is not None:
        line.append(f", {found.updates_hz:.1f} updates/s, {1e3 * found.update_lag_s:.0f} ms behind")
    console.print(line)
    if found.problems:
        console.print(Text("what to look at", "bold"))
    for problem in found.problems:
        console.print(Text.assemble(("!", "yellow"), f" {problem}"), soft_wrap=True)
    console.print(_components(found.components))
    if found.routers:
        console.print(_routers(found))


def _components(rows: list[ComponentRow]) -> Table:
    table = Table(box=None, pad_edge=False)
    for name in ("role", "name", "state", "host", "version"):
        table.add_column(name)
    for name in ("rate", "lag", "lost", "clock"):
        table.add_column(name, justify="right")
    table.add_column("replica")
    for row in rows:
        table.add_row(
            row.role,
            row.name,
            Text(row.state, _STYLES.get(row.state, "white")),
            Text(row.host),
            Text(row.version),
            "" if row.rate_hz is None else f"{row.rate_hz:.1f} Hz",
            "" if row.lag_s is None else f"{1e3 * row.lag_s:.0f} ms",
            str(row.lost) if row.role in {"service", "recorder", "viewer"} else "",
            _clock(row),
            f"{row.replica} {row.epoch}" if row.replica == "active" else row.replica,
        )
    return table


def _clock(row: ComponentRow) -> str:
    if row.clock_s is None or row.clock_error_s is None:
        return ""
    return f"{1e3 * row.clock_s:+.1f} ±{1e3 * row.clock_error_s:.1f} ms"


def _routers(found: SceneStatus) -> Table:
    table = Table("router", "host", "version", "listens at", box=None, pad_edge=False)
    table.add_column("components", justify="right")
    table.add_column("routers", justify="right")
    for row in found.routers:
        given = (row.label, row.host, row.version, " ".join(row.locators))
        table.add_row(*map(Text, given), str(row.sessions), str(row.routers))
    return table
