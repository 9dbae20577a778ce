"""Reports a soak: violations, text and JSON."""

from collections import Counter
from dataclasses import asdict
from itertools import groupby
from statistics import median
from typing import Any

from ..processes import Usage
from .load import KINDS
from .run import Soak
from .schedule import Fault

# A gap belongs to a fault that began at most so many s before it did.
_BELONGS_S = 8.0
_TIMING = frozenset({"service", "router"})
# Growth within one life of a process that is too much: by how much, as a share, and its unit.
_GROWTH = (("memory_mb", 40.0, 0.25, " MB"), ("descriptors", 10.0, 0.0, ""), ("threads", 5.0, 0.0, ""))
_LIFE_SAMPLES = 20
# Most memory of a process, whatever attacks it, and the time in which what an attack took is given back:
# its trajectories leave the window of 10 s, and housekeeping comes by.
_MOST_MB, _GIVEN_BACK_S = 800.0, 25.0
_LOG_BYTES_PER_MINUTE = 60_000
_ALONE = {kind.space for kind in KINDS.values()} - {"world"}


def cause(soak: Soak, at_s: float, seconds: float = 0.0) -> Fault | None:
    """The newest fault that a gap or a change may come from; `at_s` is its end."""
    late_s = at_s - seconds - _BELONGS_S
    # Where a service takes long to start, other faults follow before it has; a second passes unnoticed.
    last_s = at_s - max(seconds - 1.0, 0.0)
    fitting = [fault for begun_s, fault in soak.faults if late_s - fault.lasts_s <= begun_s <= last_s]
    return fitting[-1] if fitting else None


def violations(soak: Soak, longest_s: float) -> list[str]:
    """What must not be, one line each.

    No update for more than `longest_s` needs a fault of the service or the router as an excuse.
    """
    texts = [f"hypothesis id {number} was given out twice" for number in soak.findings.reused]
    for name, statuses in soak.ended.items():
        texts.append(f"{name} has ended by itself, status {', '.join(map(str, statuses))}")
    for at_s, audit in soak.audits:
        if audit.is_exact and audit.missing:
            texts.append(f"at {at_s:.0f} s {audit.missing} of {audit.sent} batches were not accounted for")
        if audit.unsettled:
            texts.append(f"at {at_s:.0f} s {audit.unsettled} batches were in no account")
    for gap in soak.findings.gaps:
        fault = cause(soak, gap.at_s, gap.seconds)
        if gap.seconds > longest_s and (fault is None or fault.target not in _TIMING):
            texts.append(f"at {gap.at_s:.0f} s no update for {gap.seconds:.1f} s ({fault or 'no fault'})")
    for at_s, body, old, new in soak.findings.changes:
        if body.split()[0] not in _ALONE:
            fault = cause(soak, at_s)
            texts.append(f"at {at_s:.0f} s {body} changed from {old} to {new} ({fault or 'no fault'})")
    return texts + _growth(soak)


def _growth(soak: Soak) -> list[str]:
    """What a process holds on to; while an attack lasts and is got over, queues grow up to their bounds."""
    attacks = [
        (at_s, at_s + fault.lasts_s + _GIVEN_BACK_S) for at_s, fault in soak.faults if fault.kind == "hostile"
    ]
    violations = []
    for name, samples in soak.usage.items():
        for starts, of_life in groupby(samples, key=lambda sample: sample[1]):
            life = [(at_s, usage) for at_s, _, usage in of_life]
            quiet = [usage for at_s, usage in life if not any(begun <= at_s < end for begun, end in attacks)]
            most = max(usage.memory_mb for _, usage in life)
            texts = _grown(quiet) + ([f"memory reached {most:.0f} MB"] if most > _MOST_MB else [])
            violations += [f"{name}, life {starts}: {text}" for text in texts]
        minutes = max(soak.seconds / 60, 1.0)
        if samples and samples[-1][2].log_bytes / minutes > _LOG_BYTES_PER_MINUTE:
            violations.append(f"{name} has logged {samples[-1][2].log_bytes} bytes")
    return violations


def _grown(life: list[Usage]) -> list[str]:
    """What has grown between the second and the last quarter of a time that was long enough to tell."""
    if len(life) < _LIFE_SAMPLES:
        return []
    quarter = len(life) // 4
    early, late = life[quarter : 2 * quarter], life[-quarter:]
    texts = []
    for name, limit, share, unit in _GROWTH:
        start, end = (median(getattr(usage, name) for usage in part) for part in (early, late))
        if end - start > max(limit, share * start):
            texts.append(f"{name.partition('_')[0]} grew from {start:.0f} to {end:.0f}{unit}")
    return texts


def as_json(soak: Soak, seed: int, longest_s: float) -> dict[str, Any]:
    """All figures, as plain values; of each process its starts, and the most that it has held."""
    findings, exact = soak.findings, [audited for _, audited in soak.audits if audited.is_exact]
    causes = ((gap, cause(soak, gap.at_s, gap.seconds)) for gap in findings.gaps)
    return {
        "seconds": round(soak.seconds, 1),
        "seed": seed,
        "faults": dict(Counter(fault.kind for _, fault in soak.faults)),
        "updates": findings.updates,
        "missed": findings.missed,
        "last_batch_ms": soak.last_batch_ms,
        "services": len(findings.sessions),
        "gaps": [[gap.seconds, str(fault or "no fault")] for gap, fault in causes],
        "ids_changed": [list(change) for change in findings.changes],
        "ids_reused": findings.reused,
        "latest_id": findings.latest_id,
        "audits": len(exact),
        "batches_audited": sum(audited.sent for audited in exact),
        "batches_missing": sum(abs(audited.missing) for audited in exact),
        "batches_unsettled": sum(audited.unsettled for _, audited in soak.audits),
        "named": sorted(soak.named),
        "usage": {name: _most(samples) for name, samples in soak.usage.items()},
        "violations": violations(soak, longest_s),
    }


def _most(samples: list[tuple[float, int, Usage]]) -> dict[str, Any]:
    held = [asdict(usage) for *_, usage in samples]
    return {"starts": samples[-1][1]} | {name: max(usage[name] for usage in held) for name in held[0]}


def lines(values: dict[str, Any]) -> list[str]:
    """The result as text, from :func:`as_json`."""
    rest = {name: value for name, value in values.items() if name not in {"usage", "violations"}}
    return [
        *(f"{name.replace('_', ' ')}: {value}" for name, value in rest.items()),
        *(f"  {name}, at most: {most}" for name, most in values["usage"].items()),
        *([f"VIOLATION: {text}" for text in values["violations"]] or ["no violation"]),
    ]
