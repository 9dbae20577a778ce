"""Results of the experiments with joints, as Markdown and plain values."""

from typing import Any

import numpy as np

from ..tables import Table, mean, plain
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
    drawn = Table(("scene", *(f"seed {seed}" for seed in seeds)))
    for scene, times in results.free.items():
        drawn.add(scene, *(f"{one:.1f}" for one in times))
    return f"Longest time in s for which two bodies had a joint.\n\n{drawn.markdown()}"


def _cost_table(results: Results) -> str:
    drawn = Table(("seed", "update without joints, ms", "update that judges a pair, ms", "share, %"))
    for seed, one in zip(results.experiment.seeds, results.cost, strict=True):
        drawn.add(str(seed), f"{one.without:.1f}", f"{one.judging:.1f}", f"{100 * one.share:.1f}")
    drawn.add("mean", "", "", f"{100 * mean(one.share for one in results.cost):.1f}")
    return drawn.markdown()


def _hand_table(results: Results) -> str:
    scored = ("NMI, fixed camera", "NMI, hand with the robot's poses", "NMI, images alone")
    drawn = Table(("seed", *scored, "largest error, mm", "largest error, degrees"))
    rows = [(r.fixed, r.with_poses, r.alone, 1e3 * r.shift, r.turn) for r in results.hand]
    names = [*map(str, results.experiment.seeds), "mean"]
    for name, row in zip(names, [*rows, np.mean(rows, axis=0).tolist()], strict=True):
        drawn.add(name, *(f"{one:.3f}" for one in row[:3]), f"{row[3]:.1f}", f"{row[4]:.2f}")
    return drawn.markdown()


def as_json(results: Results) -> Any:
    """All results as plain values."""
    parts = {name: part for name, part in vars(results).items() if name != "experiment"}
    return plain({"seeds": results.experiment.seeds, **parts})
