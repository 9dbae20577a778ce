"""Results of the experiments with joints, as Markdown and plain values."""

from dataclasses import asdict
from typing import Any

import numpy as np

from . import features, people, poses
from .experiment import Results


def markdown(results: Results) -> str:
    """Build the report: a section for each part that was run."""
    seeds = ", ".join(map(str, results.experiment.seeds))
    sections = [f"# Joints: results\n\nMade by `comotion dev reproduce joints`; seeds {seeds}."]
    if results.poses:
        count = results.experiment.pose_seeds
        sections.append(f"## On poses alone\n\nMedians of {count} seeds.\n\n{poses.table(results.poses)}")
    if results.features:
        sections.append(f"## From features\n\n{features.table(results.features)}")
    if results.sparse:
        sections.append(f"## From few features\n\n{features.table(results.sparse)}")
    if results.free:
        sections.append(f"## Bodies that move freely\n\n{_free_table(results)}")
    if results.people:
        sections.append(f"## People\n\n{people.table(results.people)}")
    if results.cost:
        sections.append(f"## Time\n\n{_cost_table(results)}")
    if results.hand:
        sections.append(f"## A camera in the hand of a robot\n\n{_hand_table(results)}")
    return "\n\n".join(sections) + "\n"


def _free_table(results: Results) -> str:
    seeds = results.experiment.seeds
    lines = [
        "Longest time in s for which two bodies had a joint.",
        "",
        "| scene | " + " | ".join(f"seed {seed}" for seed in seeds) + " |",
        "|---|" + "---|" * len(seeds),
    ]
    for scene, times in results.free.items():
        lines.append(f"| {scene} | " + " | ".join(f"{one:.1f}" for one in times) + " |")
    return "\n".join(lines)


def _cost_table(results: Results) -> str:
    lines = [
        "| seed | update without joints, ms | update that judges a pair, ms | share, % |",
        "|---|---|---|---|",
    ]
    for seed, one in zip(results.experiment.seeds, results.cost, strict=True):
        lines.append(f"| {seed} | {one.without:.1f} | {one.judging:.1f} | {100 * one.share:.1f} |")
    mean = 100 * np.mean([one.share for one in results.cost])
    return "\n".join([*lines, f"| mean | | | {mean:.1f} |"])


def _hand_table(results: Results) -> str:
    lines = [
        "| seed | NMI, fixed camera | NMI, hand with the robot's poses | NMI, images alone "
        "| largest error, mm | largest error, degrees |",
        "|---|---|---|---|---|---|",
    ]
    rows = [(r.fixed, r.with_poses, r.alone, 1e3 * r.shift, r.turn) for r in results.hand]
    names = [*map(str, results.experiment.seeds), "mean"]
    for name, row in zip(names, [*rows, np.mean(rows, axis=0).tolist()], strict=True):
        nmi, (shift, turn) = [f"{one:.3f}" for one in row[:3]], row[3:]
        lines.append(f"| {name} | " + " | ".join(nmi) + f" | {shift:.1f} | {turn:.2f} |")
    return "\n".join(lines)


def as_json(results: Results) -> dict[str, Any]:
    """All results as plain values."""
    return {
        "seeds": list(results.experiment.seeds),
        "poses": [asdict(one) for one in results.poses],
        "features": [[scene, [asdict(one) for one in found]] for scene, found in results.features],
        "sparse": [[scene, [asdict(one) for one in found]] for scene, found in results.sparse],
        "free": results.free,
        "people": [_person(one) for one in results.people],
        "cost": [asdict(one) for one in results.cost],
        "hand": [asdict(one) for one in results.hand],
    }


def _person(one: people.Person) -> dict[str, Any]:
    """Plain values; ``asdict`` does not keep counters before Python 3.12."""
    kinds = {name: dict(counter) for name, counter in one.kinds.items()}
    return dict(vars(one)) | {"apart": dict(one.apart), "kinds": kinds, "others": dict(one.others)}
