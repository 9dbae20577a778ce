"""SceneStatus -> tables for a terminal. Pure; given texts are no markup."""

from rich.console import Console
from rich.text import Text

from .scene_rows import ComponentRow, RouterRow, SceneStatus
from .watch_columns import Column, table

_STYLES = {"ok": "green", "degraded": "yellow", "stalled": "red", "silent": "red"}


def show(state: SceneStatus, console: Console) -> None:
    """Print a scene's status: what to look at, a table of components, and one of routers."""
    line = Text.assemble(f"scene {state.scene}: ", (state.overall, _STYLES[state.overall]))
    if state.updates_hz is not None and state.update_lag_s is not None:
        line.append(f", {state.updates_hz:.1f} updates/s, {1e3 * state.update_lag_s:.0f} ms behind")
    console.print(line)
    if state.problems:
        console.print(Text("what to look at", "bold"))
    for problem in state.problems:
        console.print(Text.assemble(("!", "yellow"), f" {problem}"), soft_wrap=True)
    console.print(table(state.components, _COMPONENTS))
    if state.routers:
        console.print(table(state.routers, _ROUTERS))


def _clock(row: ComponentRow) -> str:
    if row.clock_s is None or row.clock_error_s is None:
        return ""
    return f"{1e3 * row.clock_s:+.1f} ±{1e3 * row.clock_error_s:.1f} ms"


def _replica(row: ComponentRow) -> str:
    return f"{row.replica} {row.epoch}" if row.replica == "active" else row.replica


_COMPONENTS: tuple[Column[ComponentRow], ...] = (
    Column("role", None, lambda r: r.role, left=True),
    Column("name", None, lambda r: r.name, left=True),
    Column("state", None, lambda r: Text(r.state, _STYLES.get(r.state, "white")), left=True),
    Column("host", None, lambda r: r.host, left=True),
    Column("version", None, lambda r: r.version, left=True),
    Column("rate", None, lambda r: "" if r.rate_hz is None else f"{r.rate_hz:.1f} Hz"),
    Column("lag", None, lambda r: "" if r.lag_s is None else f"{1e3 * r.lag_s:.0f} ms"),
    Column("lost", None, lambda r: str(r.lost) if r.role in {"service", "recorder", "viewer"} else ""),
    Column("clock", None, _clock),
    Column("replica", None, _replica, left=True),
)
_ROUTERS: tuple[Column[RouterRow], ...] = (
    Column("router", None, lambda r: r.label, left=True),
    Column("host", None, lambda r: r.host, left=True),
    Column("version", None, lambda r: r.version, left=True),
    Column("listens at", None, lambda r: " ".join(r.locators), left=True),
    Column("components", None, lambda r: str(r.sessions)),
    Column("routers", None, lambda r: str(r.routers)),
)
