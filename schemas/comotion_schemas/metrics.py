"""Prometheus metrics of a process, at ``http://HOST:PORT/metrics``. Needs the extra `metrics`.

Off unless :func:`expose` is called, and then free: histograms do nothing and nobody asks for a
Status. What a scrape tells are the Statuses that the components of this process have published
last, under these names, with the labels `scene`, `component` and `role`:

| metric | labels | what |
|---|---|---|
| ``comotion_state`` | state | 1 for the present state |
| ``comotion_rate_hertz`` | stream | rates of Status |
| ``comotion_age_seconds`` | stream | ages of Status: how far each stream lags behind now |
| ``comotion_<counter>_total`` | | counters of Status: batches, lost, late, ... |
| ``comotion_rejected_total`` | reason | rejections |
| ``comotion_tick_seconds`` | | histogram: work left for an update of the service when it is due |
| ``comotion_watermark_lag_seconds`` | | histogram: from an update's W to its publication |
| ``comotion_publish_lag_seconds`` | | histogram: from acquisition to publication at a source |
"""

import re
import threading
import weakref
from collections.abc import Iterator
from typing import Any, Literal, Protocol

from .messages import Status

DEFAULT_HOST = "127.0.0.1"
HistogramName = Literal["tick_seconds", "watermark_lag_seconds", "publish_lag_seconds"]
_LABELS = ("scene", "component", "role")
_STATES = ("ok", "degraded", "stalled")
_BUCKETS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_HELP: dict[HistogramName, str] = {
    "tick_seconds": "Work left for an update of the service when it is due",
    "watermark_lag_seconds": "From the watermark of an update to its publication",
    "publish_lag_seconds": "From acquisition to publication at a source",
}


class Reporting(Protocol):
    """A component, as far as metrics are concerned; `last_status` is None before the first."""

    last_status: Status | None

    @property
    def scene(self) -> str:
        """Name of its scene."""


class Histogram(Protocol):
    """Takes in durations."""

    def observe(self, amount: float) -> None:
        """Count one, in seconds."""


class _Off:
    """Metrics that nobody has asked for."""

    def observe(self, amount: float) -> None:
        """Do nothing."""


OFF: Histogram = _Off()


class _Process:
    """What is exposed by this process; like logging, there is one of it."""

    def __init__(self) -> None:
        self.registry: Any = None
        self.library: Any = None
        self.histograms: dict[str, Any] = {}
        self.components: weakref.WeakSet[Any] = weakref.WeakSet()
        self.lock = threading.Lock()


_process = _Process()


def parse_address(text: str) -> tuple[str, int]:
    """Read ``PORT`` or ``HOST:PORT``; without a host it is 127.0.0.1.

    Raises
    ------
    ValueError
        If it is neither.
    """
    host, colon, port = text.rpartition(":")
    if port.isdecimal() and 0 <= int(port) <= 65535 and bool(host) == bool(colon):
        return host or DEFAULT_HOST, int(port)
    raise ValueError(f"metrics port {text!r} is neither PORT nor HOST:PORT")


def expose(host: str, port: int) -> int:
    """Serve the metrics of this process; answers with the port, which is a free one for 0.

    Raises
    ------
    ImportError
        If prometheus-client is not installed.
    OSError
        If the address cannot be served; one line that names it.
    """
    import prometheus_client.core  # noqa: PLC0415 - an extra

    registry = prometheus_client.CollectorRegistry()
    prometheus_client.ProcessCollector(registry=registry)
    registry.register(_Collector(prometheus_client))
    try:
        server, _ = prometheus_client.start_http_server(port, addr=host, registry=registry)
    except OSError as error:
        raise OSError(f"cannot serve metrics at {host}:{port}: {error.strerror or error}") from None
    _process.registry, _process.library = registry, prometheus_client
    return int(server.server_port)


def add(component: Reporting) -> None:
    """Make a component known; it is forgotten when it is gone."""
    with _process.lock:
        _process.components.add(component)


def remove(component: Reporting) -> None:
    """Forget a component that is closed."""
    with _process.lock:
        _process.components.discard(component)


def histogram(name: HistogramName, *, scene: str, component: str, role: str) -> Histogram:
    """Answer with a histogram of a component, or with :data:`OFF` when nothing is exposed."""
    if _process.registry is None:
        return OFF
    if name not in _process.histograms:
        _process.histograms[name] = _process.library.Histogram(
            f"comotion_{name}", _HELP[name], _LABELS, registry=_process.registry, buckets=_BUCKETS
        )
    found: Histogram = _process.histograms[name].labels(scene, component, role)
    return found


class _Collector:
    """Turns the last Statuses into metrics when somebody asks."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def collect(self) -> Iterator[Any]:
        """Build every family once, with a sample per component."""
        families = _Families(self._library)
        with _process.lock:
            components = list(_process.components)
        for component in components:
            status = component.last_status
            if status is not None:
                families.add((component.scene, status.component, status.role), status)
        yield from families.all.values()


class _Families:
    def __init__(self, library: Any) -> None:
        self._core = library.core
        self.all: dict[str, Any] = {}

    def add(self, labels: tuple[str, str, str], status: Status) -> None:
        for state in _STATES:
            self._gauge("state", "Whether this is the state", "state", labels, state, status.state == state)
        for stream, rate in status.rates.items():
            self._gauge("rate_hertz", "Messages per second", "stream", labels, stream, rate)
        for stream, age in status.ages.items():
            self._gauge("age_seconds", "Time since the newest data", "stream", labels, stream, age)
        for counter, count in status.counters.items():
            self._counter(re.sub(r"[^a-z0-9_]", "_", counter.lower()), labels, count)
        for reason, count in status.rejected.items():
            self._counter("rejected", labels, count, reason=reason)

    def _gauge(
        self, name: str, text: str, label: str, labels: tuple[str, ...], value: str, number: float
    ) -> None:
        if name not in self.all:
            self.all[name] = self._core.GaugeMetricFamily(f"comotion_{name}", text, labels=(*_LABELS, label))
        self.all[name].add_metric((*labels, value), float(number))

    def _counter(self, name: str, labels: tuple[str, ...], count: int, reason: str | None = None) -> None:
        extra = () if reason is None else ("reason",)
        if name not in self.all:
            text = f"Counter {name!r} of Status"
            self.all[name] = self._core.CounterMetricFamily(
                f"comotion_{name}", text, labels=(*_LABELS, *extra)
            )
        self.all[name].add_metric(labels if reason is None else (*labels, reason), float(count))
