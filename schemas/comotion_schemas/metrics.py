"""Prometheus metrics of a process, at ``http://HOST:PORT/metrics``. Needs the extra `metrics`.

Disabled unless :func:`expose` is called; histograms then do nothing. A scrape returns the last Statuses
of the components of this process, with the labels `scene`, `component` and `role`:

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
from collections.abc import Callable, Iterator
from typing import Any, Literal, Protocol

from .errors import KnownError
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
    """Interface of a component for metrics; `last_status` is None before the first Status."""

    last_status: Status | None

    @property
    def scene(self) -> str:
        """Name of its scene."""


class Histogram(Protocol):
    """A histogram of durations."""

    def observe(self, amount: float) -> None:
        """Add a duration in seconds."""


class _Off:
    """A histogram that is disabled."""

    def observe(self, amount: float) -> None:
        """Do nothing."""


OFF: Histogram = _Off()


class _Process:
    """The metrics of this process, a singleton like the state of `logging`."""

    def __init__(self) -> None:
        self.registry: Any = None
        self.library: Any = None
        self.histograms: dict[str, Any] = {}
        self.components: weakref.WeakSet[Any] = weakref.WeakSet()
        self.lock = threading.Lock()


_process = _Process()


def parse_address(text: str) -> tuple[str, int]:
    """Parse ``PORT`` or ``HOST:PORT``; the default host is 127.0.0.1.

    Raises
    ------
    ValueError
        If it is neither.
    """
    host, colon, port = text.rpartition(":")
    if port.isdecimal() and 0 <= int(port) <= 65535 and bool(host) == bool(colon):
        return host or DEFAULT_HOST, int(port)
    raise KnownError(f"metrics port {text!r} is neither PORT nor HOST:PORT")


def expose(host: str, port: int) -> int:
    """Serve the metrics of this process and return the port; 0 chooses a free port.

    Raises
    ------
    ImportError
        If prometheus-client is not installed.
    OSError
        If the address cannot be used; one line that names it.
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
    """Register a component; the reference is weak."""
    with _process.lock:
        _process.components.add(component)


def remove(component: Reporting) -> None:
    """Unregister a component."""
    with _process.lock:
        _process.components.discard(component)


def histogram(name: HistogramName, *, scene: str, component: str, role: str) -> Histogram:
    """Return a histogram of a component; :data:`OFF` if metrics are disabled."""
    if _process.registry is None:
        return OFF
    if name not in _process.histograms:
        _process.histograms[name] = _process.library.Histogram(
            f"comotion_{name}", _HELP[name], _LABELS, registry=_process.registry, buckets=_BUCKETS
        )
    labelled: Histogram = _process.histograms[name].labels(scene, component, role)
    return labelled


class _Collector:
    """Converts the last Statuses to metrics at each scrape."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def collect(self) -> Iterator[Any]:
        """Yield all metric families, with one sample per component."""
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
        gauge, counter = self._core.GaugeMetricFamily, self._core.CounterMetricFamily
        for state in _STATES:
            made = self._family(gauge, "state", "Whether this is the state", "state")
            made.add_metric((*labels, state), float(status.state == state))
        for stream, rate in status.rates.items():
            made = self._family(gauge, "rate_hertz", "Messages per second", "stream")
            made.add_metric((*labels, stream), rate)
        for stream, age in status.ages.items():
            made = self._family(gauge, "age_seconds", "Time since the newest data", "stream")
            made.add_metric((*labels, stream), age)
        for what, count in status.counters.items():
            name = re.sub(r"[^a-z0-9_]", "_", what.lower())
            self._family(counter, name, f"Counter {name!r} of Status").add_metric(labels, count)
        for reason, count in status.rejected.items():
            made = self._family(counter, "rejected", "Counter 'rejected' of Status", "reason")
            made.add_metric((*labels, reason), count)

    def _family(self, kind: Callable[..., Any], name: str, text: str, *more: str) -> Any:
        if name not in self.all:
            self.all[name] = kind(f"comotion_{name}", text, labels=(*_LABELS, *more))
        return self.all[name]
