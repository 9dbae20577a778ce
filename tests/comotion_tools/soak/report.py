"""Reports a soak: violations, a page of Markdown, JSON and a plot."""

import json
from collections import Counter
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

from comotion_experiments.plot import new_figure

from ..processes import Usage
from .load import KINDS
from .monitor import Gap
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
    fitting = [fault for begun_s, fault in soak.faults if late_s - fault.lasts_s <= begun_s <= at_s]
    return fitting[-1] if fitting else None


def violations(soak: Soak, longest_s: float) -> list[str]:
    """What must not be, one line each.

    No update for more than `longest_s` needs a fault of the service or the router as an excuse.
    """
    found = [f"hypothesis id {one} was given out twice" for one in soak.findings.reused]
    for name, statuses in soak.ended.items():
        found.append(f"{name} has ended by itself, status {', '.join(map(str, statuses))}")
    for at_s, one in soak.audits:
        if one.is_exact and one.missing:
            found.append(f"at {at_s:.0f} s {one.missing} of {one.sent} batches were not accounted for")
        if one.unsettled:
            found.append(f"at {at_s:.0f} s {one.unsettled} batches were in no account")
    for gap in soak.findings.gaps:
        fault = cause(soak, gap.at_s, gap.seconds)
        if gap.seconds > longest_s and (fault is None or fault.target not in _TIMING):
            found.append(f"at {gap.at_s:.0f} s no update for {gap.seconds:.1f} s ({fault or 'no fault'})")
    for at_s, body, before, after in soak.findings.changes:
        if body.split()[0] not in _ALONE:
            fault = cause(soak, at_s)
            found.append(f"at {at_s:.0f} s {body} changed from {before} to {after} ({fault or 'no fault'})")
    return found + _growth(soak)


def _growth(soak: Soak) -> list[str]:
    """What a process holds on to; while an attack lasts and is got over, queues grow up to their bounds."""
    attacks = [
        (at_s, at_s + fault.lasts_s + _GIVEN_BACK_S) for at_s, fault in soak.faults if fault.kind == "hostile"
    ]
    found = []
    for name, samples in soak.usage.items():
        for starts, of_life in groupby(samples, key=lambda sample: sample[1]):
            life = [(at_s, usage) for at_s, _, usage in of_life]
            quiet = [usage for at_s, usage in life if not any(begun <= at_s < end for begun, end in attacks)]
            most = max(usage.memory_mb for _, usage in life)
            texts = _grown(quiet) + ([f"memory reached {most:.0f} MB"] if most > _MOST_MB else [])
            found += [f"{name}, life {starts}: {text}" for text in texts]
        minutes = max(soak.seconds / 60, 1.0)
        if samples and samples[-1][2].log_bytes / minutes > _LOG_BYTES_PER_MINUTE:
            found.append(f"{name} has logged {samples[-1][2].log_bytes} bytes")
    return found


def _grown(life: list[Usage]) -> list[str]:
    """What has grown between the second and the last quarter of a time that was long enough to tell."""
    if len(life) < _LIFE_SAMPLES:
        return []
    quarter = len(life) // 4
    early, late = life[quarter : 2 * quarter], life[-quarter:]
    found = []
    for name, limit, share, unit in _GROWTH:
        before, after = (median(getattr(usage, name) for usage in part) for part in (early, late))
        if after - before > max(limit, share * before):
            found.append(f"{name.partition('_')[0]} grew from {before:.0f} to {after:.0f}{unit}")
    return found


def as_json(soak: Soak, seed: int, longest_s: float) -> dict[str, Any]:
    """All figures, as plain values."""
    found = soak.findings
    exact = [one for _, one in soak.audits if one.is_exact]
    return {
        "seconds": round(soak.seconds, 1),
        "seed": seed,
        "faults": dict(Counter(fault.kind for _, fault in soak.faults)),
        "updates": found.updates,
        "missed": found.missed,
        "services": len(found.sessions),
        "gaps": len(found.gaps),
        "longest_gap_s": max((gap.seconds for gap in found.gaps), default=0.0),
        "gaps_by_fault": gaps_by_fault(soak),
        "ids_changed": [list(one) for one in found.changes],
        "ids_reused": found.reused,
        "latest_id": found.latest_id,
        "audits": len(exact),
        "batches_audited": sum(one.sent for one in exact),
        "batches_missing": sum(abs(one.missing) for one in exact),
        "batches_unsettled": sum(one.unsettled for _, one in soak.audits),
        "usage": {name: _extremes(samples) for name, samples in soak.usage.items()},
        "recovery_s": [[what, round(seconds, 3)] for what, seconds in soak.recovery],
        "violations": violations(soak, longest_s),
    }


def gaps_by_fault(soak: Soak) -> dict[str, list[float]]:
    """Gaps by what they come from, in s, longest first."""
    found: dict[str, list[float]] = {}
    for gap in soak.findings.gaps:
        fault = cause(soak, gap.at_s, gap.seconds)
        name = "no fault" if fault is None else f"{fault.kind} {fault.target}"
        found.setdefault(name, []).append(gap.seconds)
    return {name: sorted(gaps, reverse=True) for name, gaps in sorted(found.items())}


def _extremes(samples: list[tuple[float, int, Usage]]) -> dict[str, Any]:
    found: dict[str, Any] = {"starts": samples[-1][1], "log_bytes": samples[-1][2].log_bytes}
    for name in ("memory_mb", "descriptors", "threads"):
        held = [getattr(usage, name) for *_, usage in samples]
        found[name] = [round(median(held), 1), round(max(held), 1)]
    return found


def lines(found: dict[str, Any]) -> list[str]:
    """The result as text, from :func:`as_json`."""
    faults = ", ".join(f"{count} {kind}" for kind, count in sorted(found["faults"].items()))
    text = [
        f"{found['seconds'] / 60:.1f} min, seed {found['seed']}; faults: {faults or 'none'}",
        f"updates: {found['updates']}, {found['missed']} missed, {found['gaps']} gaps over three periods, "
        f"longest {found['longest_gap_s']:.2f} s; {found['services']} lives of the service",
        f"accounts: {found['batches_audited']} batches in {found['audits']} stretches, "
        f"{found['batches_missing']} not accounted for",
        f"ids: {len(found['ids_changed'])} changes, {len(found['ids_reused'])} given out twice, "
        f"the largest {found['latest_id']}",
    ]
    for name, gaps in found["gaps_by_fault"].items():
        text.append(f"  gaps, {name}: {len(gaps)}, longest {gaps[0]:.2f} s")
    for name, held in found["usage"].items():
        (middle, most), files, threads = (held[key] for key in ("memory_mb", "descriptors", "threads"))
        memory = f"{middle:.0f} MB (most {most:.0f}), {files[0]:.0f} descriptors (most {files[1]})"
        threads = f"{threads[0]:.0f} threads (most {threads[1]})"
        text.append(f"  {name}: {held['starts']} starts, {memory}, {threads}, log {held['log_bytes']} bytes")
    if found["recovery_s"]:
        times = sorted(seconds for _, seconds in found["recovery_s"])
        text.append(f"  recovery: median {median(times):.2f} s, longest {times[-1]:.2f} s of {len(times)}")
    text += [f"VIOLATION: {one}" for one in found["violations"]] or ["no violation"]
    return text


def save(folder: Path, values: dict[str, Any], soak: Soak) -> list[str]:
    """Write the figures of :func:`as_json`, their text and, with matplotlib, a plot; returns the text."""
    text = lines(values)
    (folder / "soak.json").write_text(json.dumps(values, indent=2), encoding="utf-8")
    (folder / "soak.txt").write_text("\n".join(text) + "\n", encoding="utf-8")
    try:
        figure = new_figure(10, 6, dpi=90)
    except ModuleNotFoundError:
        return [*text, "no plot: pip install 'comotion[plot]'"]
    _draw(figure, soak)
    figure.savefig(folder / "soak.png")
    return text


def _draw(figure: Any, soak: Soak) -> None:
    """Draw memory and gaps over time, with the faults."""
    above, below = figure.subplots(2, 1, sharex=True)
    for name, samples in soak.usage.items():
        above.plot([s / 60 for s, *_ in samples], [u.memory_mb for *_, u in samples], lw=1, label=name)
    above.set_ylabel("memory, MB")
    above.legend(ncols=4, fontsize=8)
    gaps: list[Gap] = soak.findings.gaps
    below.vlines([g.at_s / 60 for g in gaps], 0, [g.seconds for g in gaps], lw=1)
    for kind in sorted({fault.kind for _, fault in soak.faults}):
        at = [s / 60 for s, fault in soak.faults if fault.kind == kind]
        below.plot(at, [0] * len(at), "|", label=kind)
    below.set_ylabel("time without updates, s")
    below.set_xlabel("min")
    below.legend(ncols=5, fontsize=8)
