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
from functools import cache
from typing import Any, Literal, get_args

from .errors import KnownError
from .messages import Status, StatusState

DEFAULT_HOST = "127.0.0.1"
HistogramName = Literal["tick_seconds", "watermark_lag_seconds", "publish_lag_seconds"]
_LABELS = ("scene", "component", "role")
_BUCKETS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_HELP: dict[HistogramName, str] = {
    "tick_seconds": "Work left for an update of the service when it is due",
    "watermark_lag_seconds": "From the watermark of an update to its publication",
    "publish_lag_seconds": "From acquisition to publication at a source",
}


class Histogram:
    """A histogram of durations that is disabled."""

    def observe(self, amount: float) -> None:
        """Add a duration in seconds."""


OFF = Histogram()
# Components of this process, with what its metrics are registered in, once they are exposed.
_components: weakref.WeakSet[Any] = weakref.WeakSet()
_lock = threading.Lock()
_registries: list[Any] = []


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
    import prometheus_client  # noqa: PLC0415 - an extra

    registry = prometheus_client.CollectorRegistry()
    prometheus_client.ProcessCollector(registry=registry)
    registry.register(_Collector())
    try:
        server, _ = prometheus_client.start_http_server(port, addr=host, registry=registry)
    except OSError as error:
        raise OSError(f"cannot serve metrics at {host}:{port}: {error.strerror or error}") from None
    _registries.append(registry)
    return int(server.server_port)


def add(component: Any) -> None:
    """Register a component, which has a `scene` and a `last_status`; the reference is weak."""
    with _lock:
        _components.add(component)


def remove(component: Any) -> None:
    """Unregister a component."""
    with _lock:
        _components.discard(component)


def histogram(name: HistogramName, *, scene: str, component: str, role: str) -> Histogram:
    """Return a histogram of a component; :data:`OFF` if metrics are disabled."""
    labelled: Histogram = _family(name).labels(scene, component, role) if _registries else OFF
    return labelled


@cache
def _family(name: HistogramName) -> Any:
    import prometheus_client  # noqa: PLC0415 - an extra

    return prometheus_client.Histogram(
        f"comotion_{name}", _HELP[name], _LABELS, registry=_registries[-1], buckets=_BUCKETS
    )


class _Collector:
    """Converts the last Statuses to metrics at each scrape."""

    def collect(self) -> Iterator[Any]:
        """Yield all metric families, with one sample per component."""
        families: dict[str, Any] = {}
        with _lock:
            components = list(_components)
        for component in components:
            if (status := component.last_status) is not None:
                for kind, name, text, label, value in _samples(status):
                    labels = (component.scene, status.component, status.role)
                    names = (*_LABELS, label[0]) if label else _LABELS
                    family = families.setdefault(name, kind(f"comotion_{name}", text, labels=names))
                    family.add_metric((*labels, label[1]) if label else labels, value)
        yield from families.values()


def _samples(
    status: Status,
) -> Iterator[tuple[Callable[..., Any], str, str, tuple[str, str] | None, float]]:
    """Type, name, text, further label and value of each sample of a Status."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily  # noqa: PLC0415 - an extra

    for state in get_args(StatusState):
        is_state = float(status.state == state)
        yield GaugeMetricFamily, "state", "Whether this is the state", ("state", state), is_state
    for stream, rate in status.rates.items():
        yield GaugeMetricFamily, "rate_hertz", "Messages per second", ("stream", stream), rate
    for stream, age in status.ages.items():
        yield GaugeMetricFamily, "age_seconds", "Time since the newest data", ("stream", stream), age
    for what, count in status.counters.items():
        name = re.sub(r"[^a-z0-9_]", "_", what.lower())
        yield CounterMetricFamily, name, f"Counter {name!r} of Status", None, count
    for reason, count in status.rejected.items():
        yield CounterMetricFamily, "rejected", "Counter 'rejected' of Status", ("reason", reason), count
