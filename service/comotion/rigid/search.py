"""Finds the bodies of a scene and assigns the trajectories to them: steps 5 to 9 of :mod:`.method`."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Bools, Ints, last_true
from ..geometry.frames import FEW, LONG_LIFE
from ..geometry.residuals import LEAST_COVERED
from ..partition import NO_HYPOTHESIS
from .assignment import OUTLIER, SearchResult, assign, cheapest, predicted_positions, without_sliders
from .belief import carried_costs
from .candidates import cluster_rows
from .fits import Fits
from .selection import membership_prices, select
from .subset import Scene, choose_subset, known_rows, rows_to_fit, unexplained


def follow(scene: Scene, fits: Fits) -> SearchResult:
    """Fit the known bodies to their trajectories, and assign all trajectories to them: steps 6 to 9."""
    return _compare_all(scene, fits, known_rows(scene))


def search(scene: Scene, fits: Fits, followed: SearchResult, outlying: Bools) -> SearchResult:
    """Find the bodies of a scene: steps 5 to 9.

    `outlying` bool [N] says what the known bodies do not explain. Bodies are found in the subset. Where no
    cluster is a body, the followed ones stand; else all trajectories are compared with what was found. In a
    small scene bodies are fitted to the trajectories that were assigned to them, twice.
    """
    subset = choose_subset(scene, outlying)
    labels, new = _first_bodies(scene, fits if scene.small else None, subset, outlying)
    if not len(new):
        return followed
    if not scene.small:
        members = [np.isin(np.arange(len(outlying)), subset[labels == k]) for k in new]
        rows = known_rows(scene) + [rows_to_fit(scene, group) for group in members]
        return _compare_all(scene, fits, rows)
    rows = _assigned_rows(scene, 1 + int(labels.max(initial=0)), labels)
    result = _compare_all(scene, fits, rows)
    labels = without_sliders(result.assignment.labels, result.evidence)
    rows = _assigned_rows(scene, len(result.bodies), labels)
    return _compare_all(scene, fits, rows)


def has_news(scene: Scene, result: SearchResult) -> bool:
    """Whether a few trajectories of each body, and those that none explains, have a new body."""
    outlying = unexplained(scene, result)
    return bool(len(_first_bodies(scene, None, choose_subset(scene, outlying), outlying)[1]))


def _first_bodies(scene: Scene, fits: Fits | None, subset: Ints, outlying: Bools) -> tuple[Ints, Ints]:
    """The cheapest body for each of the trajectories of the subset, intp [n], and which bodies are new.

    `fits` are those of the scene, if it is searched as a whole.
    """
    part = scene.of(subset) if fits is None else scene
    # In a small scene every cluster is a candidate: a body that moves slowly is not yet outlying.
    previous_rows, clusters = known_rows(part), cluster_rows(part, outlying[subset] | scene.small)  # 5
    if not clusters:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    fits = fits or Fits(part.frames)
    fitted = fits.of(previous_rows + clusters, still=False)  # 6
    chosen, costs = select(part, fitted, fits.costs(fitted))  # 7, 8
    labels = without_sliders(cheapest(costs.body, costs.outlier), costs)
    return labels, np.flatnonzero(np.array(chosen) > len(previous_rows))


def _compare_all(scene: Scene, fits: Fits, rows: list[Ints]) -> SearchResult:
    """Fit bodies to rows, intp [m] each, select the best, and assign every trajectory to one of them."""
    fitted = fits.of(rows, still=True)  # 6
    chosen, evidence = select(scene, fitted, fits.costs(fitted))  # 7, 8
    fitted = [fitted[k] for k in chosen]
    cost, prices = evidence.body + carried_costs(scene, fitted), membership_prices(scene, fitted)
    rough = cheapest(cost + prices, evidence.outlier)
    if scene.static is not None:
        # A resting member of a resting body looks like the background: its membership has a price here too.
        background = np.flatnonzero(scene.judged & (scene.hypotheses == scene.static))
        resting = np.array([body.costed.rests for body in fitted])
        cost[np.ix_(background, resting)] += prices[resting]
    bodies = [body.body for body in fitted]
    position = predicted_positions(scene.frames, scene.newest, bodies, rough)
    assignment = assign(scene.frames, cost, evidence.outlier, position)  # 9
    assignment = replace(assignment, labels=undecided(scene, assignment.labels))
    return SearchResult(bodies, assignment, evidence)


def _assigned_rows(scene: Scene, count: int, labels: Ints) -> list[Ints]:
    """Rows of the trajectories that are assigned to each of `count` bodies but the static one.

    Also those of separate hypotheses at rest: a body that is dropped later may displace them.
    """
    frames = scene.frames
    # Newborn members would determine poses where few other members are left.
    not_newborn = scene.judged | (scene.hypotheses != NO_HYPOTHESIS)
    informative = not_newborn & frames.informative
    groups = [frames.rows_of((labels == k) & informative) for k in range(1, count)]
    for hypothesis in np.unique(scene.hypotheses[scene.resting]).tolist():
        rows = frames.rows_of((scene.hypotheses == hypothesis) & informative)
        if not any(np.array_equal(rows, group) for group in groups):
            groups.append(rows)
    return groups


def undecided(scene: Scene, labels: Ints) -> Ints:
    """The labels, intp [N], but :data:`OUTLIER` for features that may be a lost body's return.

    By place alone, the features of a body that returns would be those of the bodies about it, and of the
    static one, which has members everywhere. So while a hypothesis has no features, after it lost most of
    them at once, features that appear later among other newborn ones are outliers until their motion is
    known. Those that appear as soon as it loses them are the same ones, under other names.
    """
    frames = scene.frames
    newborn = frames.current & ~scene.judged & (scene.hypotheses == NO_HYPOTHESIS)
    doubtful = newborn & (labels != OUTLIER)
    if not doubtful.any():
        return labels
    born = frames.stamps[-1] - (frames.life * 1e9).astype(np.int64)
    doubtful = np.flatnonzero(doubtful & (born > _first_loss(scene)))
    current = np.flatnonzero(frames.current)
    # The nearest neighbour of each feature is the feature itself.
    beside = np.arange(min(FEW + 1, len(current))) + 1
    nearest = cKDTree(scene.newest[current]).query(scene.newest[doubtful], beside)[1]
    crowd = 2 * (newborn[current][nearest].sum(1) - 1) > FEW
    decided = labels.copy()
    decided[doubtful[crowd]] = OUTLIER
    return decided


def _first_loss(scene: Scene) -> float:
    """When the first of the hypotheses without a feature had lost most at once, ns; infinite for none."""
    frames, first_loss = scene.frames, np.inf
    at_once = 1.5e9 * frames.step  # from one frame to the next
    first_rows = np.unique(frames.owner, return_index=True)[1]
    last = frames.stamps[last_true(frames.w[first_rows] > 0)]
    gone = np.setdiff1d(scene.hypotheses[~frames.current], scene.hypotheses[frames.current])
    for hypothesis in gone[gone != NO_HYPOTHESIS].tolist():
        ends = last[scene.hypotheses == hypothesis]
        before = ends.max() - ends
        lost = np.count_nonzero(before < at_once)
        if lost >= max(FEW, LEAST_COVERED * np.count_nonzero(before < LONG_LIFE * 1e9)):
            first_loss = min(first_loss, ends.max() + at_once)
    return first_loss
