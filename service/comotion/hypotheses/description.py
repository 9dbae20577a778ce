"""Describes groups as hypotheses are published."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from comotion_schemas import Box, Hypothesis

from ..arrays import Labels
from ..partition import NO_HYPOTHESIS, Partition, PoseReference


def describe(
    space: str,
    partition: Partition,
    ids: Labels,
    labels: Labels,
    references: Mapping[int, PoseReference],
    confirmed: Callable[[int], bool],
    box: Callable[[int, bool], Box],
) -> list[Hypothesis]:
    """Hypotheses that have a current member, by id.

    Parameters
    ----------
    space
        Name of the space.
    partition
        Groups 0 to K - 1.
    ids
        int64 [K], hypothesis of each group, negative for none.
    labels
        int64 [n], hypotheses of the current trajectories.
    references
        Of every hypothesis in `ids`; brought up to date.
    confirmed
        Whether a hypothesis is confirmed.
    box
        Box of a hypothesis by its id and whether it has a pose.
    """
    found = []
    for group, one in zip(partition.described, ids.tolist(), strict=True):
        if one == NO_HYPOTHESIS:
            continue
        reference = references[one]
        # A hypothesis without a current member keeps its pose up to date for their return.
        pose = group.pose_since(reference) if group.pose_since is not None else None
        members = np.flatnonzero(labels == one)
        if not len(members):
            continue
        found.append(
            Hypothesis(
                id=one,
                space=space,
                size=len(members),
                born_ns=reference.born_ns,
                state=group.state,
                centroid=partition.position[members].mean(0).tolist(),
                pose=pose,
                twist=group.twist,
                noise=group.noise,
                confirmed=confirmed(one),
                box=box(one, pose is not None),
            )
        )
    return sorted(found, key=lambda h: h.id)


def absent(last: Hypothesis) -> Hypothesis:
    """A hypothesis without current members, as it was described last."""
    return replace(last, size=0, absent=True, confirmed=True)
