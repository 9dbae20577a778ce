"""Lists what a person should look at in a scene, causes first. Pure."""

from collections.abc import Sequence

from .scene_rows import ComponentRow, Overall, RouterRow

USUAL_RATE_HZ = 30.0
"""Stands for the rate of a scene whose sources are unknown."""
_MOST_NAMES = 4


def find_problems(rows: list[ComponentRow], routers: Sequence[RouterRow] = ()) -> list[str]:
    """Return what a person should look at, one line each.

    Links, clocks and versions come first: what else is wrong is often their effect.
    """
    problems = _router_problems(routers) + _clock_problems(rows)
    problems += _versions_differ("versions", [(row.version, row.name) for row in rows])
    problems += _versions_differ("versions of Zenoh", [(row.version, row.label) for row in routers])
    services = [row for row in rows if row.role == "service"]
    speaking = [row for row in services if row.replica != "standby"]
    if not services:
        problems.append("no service: 'comotion serve' starts one")
    elif not speaking:
        problems.append("all services are standbys: none speaks for the scene")
    elif len(speaking) > 1:
        problems.append(f"several services speak: {', '.join(row.name for row in speaking)}")
    if len(services) == 1 and services[0].replica == "active":
        problems.append(f"service {services[0].name} has no standby")
    for row in rows:
        if row.state != "ok":
            why = f": {row.message}" if row.message else ""
            problems.append(f"{row.role} {row.name} is {row.state}{why}")
    return problems


def overall(rows: list[ComponentRow], problems: list[str]) -> Overall:
    """State of a scene: stalled without a service that speaks, degraded with a problem."""
    speaking = [row for row in rows if row.role == "service" and row.replica != "standby"]
    if not speaking or all(row.state in {"stalled", "silent"} for row in speaking):
        return "stalled"
    return "degraded" if problems else "ok"


def _router_problems(routers: Sequence[RouterRow]) -> list[str]:
    problems = []
    for row in routers:
        if row.routers < row.dials:
            problems.append(
                f"router {row.label} reaches {row.routers} of the {row.dials} routers that it is told to "
                "connect to: what is beyond is not seen here"
            )
        elif not row.routers and len(routers) > 1:
            problems.append(f"router {row.label} reaches no other router")
    return problems


def _versions_differ(what: str, given: list[tuple[str, str]]) -> list[str]:
    """Say who has which version, where there are several."""
    of: dict[str, list[str]] = {}
    for version, name in given:
        if version:
            of.setdefault(version, []).append(name)
    if len(of) < 2:
        return []
    words = (f"{version} ({_few(sorted(names))})" for version, names in sorted(of.items()))
    return [f"{what} differ: {', '.join(words)}"]


def _few(names: list[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def _clock_problems(rows: list[ComponentRow]) -> list[str]:
    """Clocks that differ by more than half a frame of a source, beyond the error of the measurement."""
    rates = [row.rate_hz for row in rows if row.role == "source" and row.rate_hz]
    fastest = max(rates, default=USUAL_RATE_HZ)
    problems = []
    for row in rows:
        if row.clock_s is None or row.clock_error_s is None or row.role in {"viewer", "recorder"}:
            continue
        limit = 0.5 / (row.rate_hz if row.role == "source" and row.rate_hz else fastest)
        if abs(row.clock_s) - row.clock_error_s > limit:
            way = "ahead of" if row.clock_s > 0 else "behind"
            host = f" ({row.host})" if row.host else ""
            problems.append(
                f"the clock of {row.role} {row.name}{host} is {1e3 * abs(row.clock_s):.0f} ms {way} "
                f"the service's, more than half a frame ({1e3 * limit:.0f} ms)"
            )
    return problems
