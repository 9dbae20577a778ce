"""One run of the link experiment: scene and seed -> counts of right links, and scores with and without."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth, bodies_of, labels_of, score_labels
from comotion_clients.scoring import Observed
from comotion_schemas import UNDETERMINED, HypothesisUpdate

from ..fusion.study import in_time_order
from ..offline import run_offline
from ..rendered import Sources
from .setup import DEPTH_CAMERA, PLAIN_CAMERA, PLAIN_SPACE

Labels = NDArray[np.int64]
Objects = NDArray[np.int32]

MIN_FEATURES = 3
"""Least number of features with known object for a hypothesis to be assigned to an object."""
PURE = 0.8
"""Least share of these features on that object for the hypothesis to be pure."""


@dataclass
class Count:
    """Links given, those of them that are right, and hypotheses that could and that do have a right one."""

    links: int = 0
    right: int = 0
    linkable: int = 0
    found: int = 0

    def __add__(self, other: "Count") -> "Count":
        return Count(
            self.links + other.links,
            self.right + other.right,
            self.linkable + other.linkable,
            self.found + other.found,
        )

    @property
    def precision(self) -> float:
        """Share of the links that are right; NaN without links."""
        return self.right / self.links if self.links else float("nan")

    @property
    def recall(self) -> float:
        """Share of the hypotheses with a body to be linked to that are linked to it; NaN without any."""
        return self.found / self.linkable if self.linkable else float("nan")


@dataclass(frozen=True)
class Partitions:
    """Mean scores over the updates of several ways to read the same hypotheses.

    `apart`: each hypothesis for itself. `rest`: what is called static is one, which takes no links.
    `joined`: linked hypotheses are one. `oracle`: those are one whose features are mostly of one object.
    """

    apart: float
    rest: float
    joined: float
    oracle: float


@dataclass(frozen=True)
class Outcome:
    """What one seed of one scene gave.

    Attributes
    ----------
    moving, resting
        Links of image hypotheses whose true object moves, and of those of the background.
    pure
        Links of moving ones, where both ends are pure.
    nmi
        NMI over the features of both cameras.
    nmi_plain, error_plain
        NMI and misclassification rate over the plain camera's features alone.
    """

    moving: Count
    resting: Count
    pure: Count
    nmi: Partitions
    nmi_plain: Partitions
    error_plain: Partitions


@dataclass
class _Scorer:
    truth: Truth
    observed: Observed = field(default_factory=Observed)
    moving: Count = field(default_factory=Count)
    resting: Count = field(default_factory=Count)
    pure: Count = field(default_factory=Count)
    rows: list[list[list[float]]] = field(default_factory=list)

    def add(self, update: HypothesisUpdate, _: Score) -> None:
        """Score one update."""
        labels, objects, plain = self._tracks(update)
        if not (plain & (objects >= 0)).any() or not (~plain & (objects >= 0)).any():
            return
        main = main_objects(labels, objects)
        moving, resting = count_links(update, main)
        self.moving += moving
        self.resting += resting
        self.pure += count_links(update, main_objects(labels, objects, PURE))[0]
        readings = [{}, rested(update), bodies_of(update), by_object(main)]
        found = []
        for reading in readings:
            read_as = np.array([reading.get(one, one) for one in labels.tolist()], np.int64)
            both = score_labels(read_as, objects, update.stamp_ns)
            alone = score_labels(read_as[plain], objects[plain], update.stamp_ns)
            found.append([both.nmi, alone.nmi, alone.misclassification])
        self.rows.append(found)

    def _tracks(self, update: HypothesisUpdate) -> tuple[Labels, Objects, NDArray[np.bool_]]:
        """Hypothesis and true object of every observed feature, and whether the plain camera's."""
        observed = self.observed.at(update.stamp_ns)
        plain = [np.full(len(ids), source == PLAIN_CAMERA) for (source, _), ids in observed.items()]
        return *labels_of(update, self.truth, observed), np.concatenate(plain)


def main_objects(labels: Labels, objects: Objects, share: float = 0.0) -> dict[int, int]:
    """Object of which each hypothesis has most features, and at least a share, where enough are known."""
    found = {}
    for one in np.unique(labels[labels != UNDETERMINED]).tolist():
        known = objects[(labels == one) & (objects >= 0)]
        votes = np.bincount(known)
        if len(known) >= MIN_FEATURES and votes.max() >= share * len(known):
            found[one] = int(votes.argmax())
    return found


def count_links(update: HypothesisUpdate, main: Mapping[int, int]) -> tuple[Count, Count]:
    """Links of the plain camera's hypotheses against the truth: of moving objects, and of the background."""
    moving, resting = Count(), Count()
    bodies = {main[h.id] for h in update.hypotheses if h.space != PLAIN_SPACE and h.id in main}
    for h in update.hypotheses:
        if h.space != PLAIN_SPACE or h.id not in main:
            continue
        count, right = (moving if main[h.id] > 0 else resting), False
        for other in h.linked or ():
            if other in main:
                count.links += 1
                count.right += main[other] == main[h.id]
                right |= main[other] == main[h.id]
        count.linkable += main[h.id] in bodies
        count.found += right
    return moving, resting


def rested(update: HypothesisUpdate) -> dict[int, int]:
    """Lowest static id for every static hypothesis: what can be said without calibration."""
    static = [h.id for h in update.hypotheses if h.state == "static"]
    return dict.fromkeys(static, min(static, default=0))


def by_object(main: Mapping[int, int]) -> dict[int, int]:
    """Lowest id among the hypotheses of the same true object."""
    lowest: dict[int, int] = {}
    for one, number in sorted(main.items()):
        lowest.setdefault(number, one)
    return {one: lowest[number] for one, number in main.items()}


def run_seed(sources: Sources, config: FusionConfig, *, period: float = 1 / 3) -> Outcome:
    """Fuse both cameras and score every update.

    Parameters
    ----------
    sources
        Messages of both cameras.
    config
        Parameters of the core, with the plain camera's calibration.
    period
        Seconds between updates.
    """
    scorer = _Scorer(Truth())
    run_offline(
        in_time_order([sources[DEPTH_CAMERA], sources[PLAIN_CAMERA]]),
        config,
        truth=scorer.truth,
        observed=scorer.observed,
        period=period,
        on_update=scorer.add,
    )
    means = np.nanmean(np.array(scorer.rows), axis=0)
    nmi, nmi_plain, error_plain = (Partitions(*column) for column in means.T.tolist())
    return Outcome(scorer.moving, scorer.resting, scorer.pure, nmi, nmi_plain, error_plain)
