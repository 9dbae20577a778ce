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
from collections.abc import Callable, Iterator, Mapping
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


Observe = Callable[[float], None]
"""Adds a duration in seconds."""
components: list[Any] = []
"""The components of this process, which have a `scene` and a `last_status`."""
# What the metrics are registered in, once they are exposed.
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


def histogram(name: HistogramName, *, scene: str, component: str, role: str) -> Observe:
    """Return what adds to a histogram of a component; :func:`off` if metrics are disabled."""
    observe: Observe = _family(name).labels(scene, component, role).observe if _registries else off
    return observe


def off(seconds: float) -> None:
    """Add a duration to nothing."""


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
        for component in components.copy():
            if (status := component.last_status) is not None:
                for kind, name, text, label, values in _tables(status):
                    labels = [*_LABELS, label] if label else _LABELS
                    family = families.setdefault(name, kind(f"comotion_{name}", text, labels=labels))
                    for key, value in values.items():
                        family.add_metric(
                            [component.scene, status.component, status.role, key][: len(labels)], value
                        )
        yield from families.values()


def _tables(status: Status) -> Iterator[tuple[Callable[..., Any], str, str, str, Mapping[Any, float]]]:
    """Type, name and text of each metric of a Status, its further label, and its values by that."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily  # noqa: PLC0415 - an extra

    states = {state: float(status.state == state) for state in get_args(StatusState)}
    yield GaugeMetricFamily, "state", "Whether this is the state", "state", states
    yield GaugeMetricFamily, "rate_hertz", "Messages per second", "stream", status.rates
    yield GaugeMetricFamily, "age_seconds", "Time since the newest data", "stream", status.ages
    yield CounterMetricFamily, "rejected", "Counter 'rejected' of Status", "reason", status.rejected
    for what, count in status.counters.items():
        name = re.sub(r"[^a-z0-9_]", "_", what.lower())
        yield CounterMetricFamily, name, f"Counter {name!r} of Status", "", {"": count}
