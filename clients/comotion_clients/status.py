"""One look at a running scene, by subscriptions and queries, and its tables for a terminal."""

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Literal

import zenoh
from rich.console import Console
from rich.text import Text

from comotion_schemas import DEFAULT_SCENE, DecodeError, HypothesisUpdate, Status, decode_as
from comotion_schemas.transport import SessionSettings, client_settings, connect

from .feed import SceneFeed
from .scene_model import SceneModel
from .scene_rows import ComponentRow, RouterRow, SceneStatus
from .watch_columns import Column, table

ROUTERS = "@/*/router"
LOOK_S = 2.3
"""How long one look takes: two Statuses of each component."""
_QUERY_S = 0.5  # between two rounds of queries
_ANSWER_S = 2.0  # a host that does not answer in this time has no clock offset in this look
_POLL_S = 0.05
_EACH = zenoh.ConsolidationMode.NONE


def status(
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    *,
    wait: Literal["ok"] | None = None,
    timeout: float = 10.0,
    expect: Sequence[str] = (),
) -> SceneStatus:
    """Look at a scene.

    With `wait`, look until the scene is in this state; `timeout` is in s, for that and for a router; `expect`
    names components that must be there.

    Raises
    ------
    TimeoutError
        If no router answers.
    ValueError
        If the scene name or an endpoint is not valid.
    """
    settings = settings or client_settings()
    deadline = time.monotonic() + timeout
    with connect(settings, timeout=timeout) as session, _StatusFeed(session, scene) as feed:
        while True:
            feed.run(LOOK_S)
            state = missing(feed.model.status(time.monotonic()), expect)
            if wait is None or state.overall == wait or time.monotonic() > deadline:
                return state


def missing(state: SceneStatus, expected: Sequence[str]) -> SceneStatus:
    """Add the components that are expected and not there to the problems."""
    present = {row.name for row in state.components}
    absent = [f"{name} is not there" for name in expected if name not in present]
    overall = "degraded" if absent and state.overall == "ok" else state.overall
    return replace(state, overall=overall, problems=[*state.problems, *absent])


class _StatusFeed(SceneFeed):
    """Fills a model with what arrives and what is answered."""

    def __init__(self, session: zenoh.Session, scene: str) -> None:
        super().__init__(session, scene, (Status, HypothesisUpdate), everybody=True)
        self.model = SceneModel(scene)

    def run(self, duration_s: float) -> None:
        """Listen and ask for some time."""
        end = time.monotonic() + duration_s
        for sample, *_ in self._replies(ROUTERS):
            with suppress(ValueError, RecursionError):
                if isinstance(described := json.loads(sample.payload.to_string()), dict):
                    self.model.on_router(described)
        queried_s = float("-inf")
        while (now := time.monotonic()) < end:
            self.pour(self.model)
            if now - queried_s > _QUERY_S:
                queried_s = now
                self._query()
            time.sleep(_POLL_S)
        self.pour(self.model)

    def _query(self) -> None:
        """Ask services for their Status, and the cache of every component."""
        for sample, sent_s, received_s in self._replies(self._keys.query("status")):
            with suppress(DecodeError):
                self.model.on_answer(decode_as(Status, sample.payload.to_bytes()), sent_s, received_s)
        for name in [name for name, record in self.model.components.items() if record.status]:
            key = f"{self._keys.stream('status', name)}/@adv/**"
            for _, sent_s, received_s in self._replies(key):
                self.model.on_cache_answer(name, received_s - sent_s)

    def _replies(self, key: str) -> Iterator[tuple[zenoh.Sample, float, float]]:
        """Yield (sample, time of the query, time of the reply) by the monotonic clock, as wall time."""
        ahead_s = time.time() - time.monotonic()
        sent_s = time.monotonic()
        # A cache answers with the key of what it keeps, not with that of the query.
        replies = self._session.get(
            key, timeout=_ANSWER_S, accept_replies=zenoh.ReplyKeyExpr.ANY, consolidation=_EACH
        )
        for reply in replies:
            if reply.ok is not None:
                yield reply.ok, sent_s + ahead_s, time.monotonic() + ahead_s


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
    Column(
        "replica", None, lambda r: r.replica + (f" {r.epoch}" if r.replica == "active" else ""), left=True
    ),
)
_ROUTERS: tuple[Column[RouterRow], ...] = (
    Column("router", None, lambda r: r.label, left=True),
    Column("host", None, lambda r: r.host, left=True),
    Column("version", None, lambda r: r.version, left=True),
    Column("listens at", None, lambda r: " ".join(r.locators), left=True),
    Column("components", None, lambda r: str(r.sessions)),
    Column("routers", None, lambda r: str(r.routers)),
)
