"""Lists what a person should look at in a scene. Pure."""

from dataclasses import dataclass

USUAL_RATE_HZ = 30.0
"""Stands for the rate of a scene whose sources are unknown."""


@dataclass(frozen=True)
class ComponentRow:
    """One component: its last Status, and how its clock differs.

    `clock_s` is how far its clock is ahead of the speaking service's, or of this machine's without one;
    `clock_error_s` bounds the error; both None if unknown. `age_s` is that of its Status.
    """

    role: str
    name: str
    state: str
    host: str
    version: str
    present: bool
    age_s: float
    rate_hz: float | None
    lag_s: float | None
    lost: int
    clock_s: float | None
    clock_error_s: float | None
    replica: str
    epoch: int
    message: str


def find_problems(rows: list[ComponentRow]) -> list[str]:
    """Return what a person should look at, one line each."""
    problems = []
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
    problems += [_describe(row) for row in rows if row.state != "ok"]
    problems += _clock_problems(rows)
    versions = {row.version for row in rows if row.version}
    if len(versions) > 1:
        problems.append(f"versions differ: {', '.join(sorted(versions))}")
    return problems


def _describe(row: ComponentRow) -> str:
    return f"{row.role} {row.name} is {row.state}" + (f": {row.message}" if row.message else "")


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
