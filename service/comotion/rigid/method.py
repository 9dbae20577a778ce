"""The default method (``method = "comotion"``): a hypothesis is a rigid body with a motion.

Trajectories in, groups of them out. The steps of an update; all lengths are relative to the noise or to the
extent of the scene, so that no parameter has a scale:

1.  Read the trajectories of the window (:mod:`.tracks`). Where the last fit explains what is new, it is held
    (:mod:`.continuation`), and step 10 follows.
2.  Register the sources: correct their extrinsics and clocks by bodies that two of them see
    (:mod:`.registration`).
3.  Resample the trajectories on common frames (:mod:`.resampling`).
4.  Estimate the noise of each, and the tolerance that deformation adds to it (:mod:`.noise`).
5.  Choose the trajectories to search, all of them in a small scene (:mod:`.subset`), and find candidates: the
    previous hypotheses, and clusters of the normalised deviation of distances (:mod:`.candidates`).
6.  Fit a body with a pose in each frame to each candidate (:mod:`.fits`, :mod:`.procrustes`). Once clusters
    are sorted out, it has one pose for each rest of it (:mod:`.rest`).
7.  Compute what each trajectory costs under each body (:mod:`.costs`).
8.  Select the bodies of least total cost (:mod:`.selection`).
9.  Assign every trajectory to a body (:mod:`.assignment`).
10. Describe the motion of each body (:mod:`.motions`).
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Ints, Labels, Slots, Stamps
from ..config import FusionConfig, RigidConfig
from ..matching import continued, largest_total
from ..partition import (
    NO_HYPOTHESIS,
    BodyMotion,
    Method,
    Partition,
    PoseReference,
    Previous,
    SpaceSpec,
)
from ..trajectories.window import Window
from .anchored import anchored_motions
from .arrivals import undecided
from .assignment import (
    SearchResult,
    assign,
    cheapest,
    posterior,
    predicted_positions,
    same_body,
    without_sliders,
)
from .belief import Belief, carried_costs
from .candidates import cluster_rows
from .continuation import Fit, held, holding, judged
from .costs import Costs, excess_costs
from .fits import Fits, Fitted
from .motions import describe_bodies
from .noise import NoiseEstimates
from .registration import Registration
from .resampling import make_frames
from .selection import STATIC, membership_prices, select, supported
from .subset import (
    Scene,
    Subset,
    choose_subset,
    extended_rows,
    known_rows,
    unexplained,
)
from .tracks import Tracks, read_tracks

# Share of the window after which bodies are sought even where the known ones explain everything, and in which
# the same unexplained trajectory is no cause for another search.
_SEARCH_SHARE = 0.1


class RigidMethod(Method):
    """The rigid-motion method for one space in a metric (or any Euclidean) unit.

    Parameters
    ----------
    config
        `rigid` and `window` matter here.
    spec
        The space.
    """

    matching = staticmethod(largest_total)
    established = True
    cutting = True

    def __init__(self, config: FusionConfig, spec: SpaceSpec) -> None:
        self._config = config.rigid
        self._dim = spec.dim
        self._registration = Registration()
        self._noise = NoiseEstimates(spec.dim)
        self._belief = Belief()
        self._chances: Floats = np.zeros((0, 1))
        self._last: Fit | None = None
        # When bodies were sought last, and when what could not be explained, by key.
        self._searched_ns = 0
        self._odd: dict[int, int] = {}

    @property
    def delays_ns(self) -> Mapping[int, int]:
        """What it adds to the times of sources that are late, by session number."""
        found = self._registration.found.items()
        return {one: round(offset.delay * 1e9) for one, offset in found if offset.late}

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories.

        Without `searching` the known bodies are fitted and the trajectories assigned to them: neither new
        bodies nor the offsets of sources are sought.
        """
        tracks = read_tracks(window, current, stamp_ns)  # 1
        if not len(tracks.key):
            return self._nothing()
        self._learn(previous)
        fit = self._held(window, tracks, stamp_ns) or self._fitted(window, tracks, stamp_ns, previous)
        self._last, tracks, labels = fit, fit.tracks, fit.result.assignment.labels
        described = describe_bodies(tracks, fit.frames, fit.result)  # 10
        chosen = np.searchsorted(tracks.key, window.key[current])
        self._chances = chances = posterior(fit.result.assignment)[chosen]
        confidence = chances[np.arange(len(chosen)), labels[chosen] + 1]
        position = tracks.newest[chosen, : self._dim]
        here = np.flatnonzero(tracks.stop > tracks.start)
        deciding = np.ones(len(here), np.bool_)
        return Partition(tracks.slot[here], labels[here], deciding, confidence, position, described)

    def affinity(self) -> NDArray[np.float32]:
        """Probability that two trajectories belong to one body, [n, n] of the last update."""
        return same_body(self._chances)

    def motions(
        self, ids: Labels, references: Mapping[int, PoseReference], wanted: Collection[int]
    ) -> dict[int, BodyMotion]:
        """Motion of the wanted hypotheses over the window, by id; those without a known motion are left out.

        `ids` int64 [K] are the hypotheses of the last partition's groups.
        """
        if self._last is None:
            return {}
        known = {one: (k, references[one]) for k, one in enumerate(ids.tolist()) if one in references}
        terms = self._last.tracks, self._last.frames, self._last.result
        return anchored_motions(*terms, {one: known[one] for one in wanted if one in known})

    def state(self) -> dict[str, Any]:
        """The registration of the sources, and what is believed of hypotheses."""
        return {"offsets": self._registration.state(), "belief": self._belief.state()}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; all else is read from the window."""
        del window
        if state:
            self._registration.load(state["offsets"])
            self._belief.load(state["belief"])

    def _held(self, window: Window, now: Tracks, stamp_ns: int) -> Fit | None:
        """The last result, where it explains what is new."""
        if self._last is None:
            return None
        odd = np.array(sorted(self._odd), np.int64)
        return held(self._last, window, now, stamp_ns, odd, self._config)

    def _fitted(self, window: Window, tracks: Tracks, stamp_ns: int, previous: Previous) -> Fit:
        """The result of steps 2 to 9."""
        tracks = self._registration.correct(tracks)  # 2
        spans = window.span_ns, window.gap_ns
        frames = make_frames(tracks, self._noise, stamp_ns, *spans, self._config)  # 3, 4
        static = int(previous.ids[0]) if len(previous.ids) and previous.ids[0] != NO_HYPOTHESIS else None
        before = previous.labels[tracks.slot]
        scene = self._belief.scene(frames, tracks.newest, before, static, self._config.min_life)
        result, due = self._grouped(scene)  # 5 to 9
        if due:
            self._registration.learn(tracks, frames, result.assignment.labels)  # 2, for the next fit
        holds = holding(self._last, frames, result.assignment.labels)
        return Fit(tracks, frames, result, stamp_ns, judged(frames, self._config), holds)

    def _learn(self, previous: Previous) -> None:
        if self._last is not None and len(previous.ids) == len(self._last.result.bodies):
            self._belief.learn(self._last.result, self._last.frames, previous.ids)

    def _grouped(self, scene: Scene) -> tuple[SearchResult, bool]:
        """The bodies and their trajectories, and whether others were sought."""
        fits = Fits(scene.frames, self._config)
        followed = follow(scene, fits, self._config)
        excess = excess_costs(followed.evidence, followed.assignment.labels, self._config)
        odd = unexplained(scene, followed.assignment.labels, excess)
        if self.searching and self._due(scene, scene.frames.key[odd]):
            return search(scene, fits, followed, odd, excess, self._config), True
        return followed, False

    def _due(self, scene: Scene, odd: Stamps) -> bool:
        """Whether to search for new bodies: where something is unexplained that was not lately, or seldom.

        `odd` int64 [n] are the keys of what is unexplained.
        """
        stamps, before = scene.frames.stamps, self._odd
        now_ns, span_ns = int(stamps[-1]), int(stamps[-1] - stamps[0])
        self._odd = {key: at for key, at in before.items() if now_ns - at < _SEARCH_SHARE * span_ns}
        long_ago = now_ns - self._searched_ns >= _SEARCH_SHARE * span_ns
        if long_ago or not self._odd.keys() >= set(odd.tolist()):
            self._searched_ns = now_ns
            self._odd |= dict.fromkeys(odd.tolist(), now_ns)
            return True
        return False

    def _nothing(self) -> Partition:
        self._belief.forget()
        self._last, self._chances = None, np.zeros((0, 1))
        nobody = np.zeros(0, np.intp)
        return Partition(nobody, nobody, np.zeros(0, np.bool_), np.zeros(0), np.zeros((0, self._dim)))


def follow(scene: Scene, fits: Fits, config: RigidConfig) -> SearchResult:
    """Fit the known bodies to their trajectories, and assign all trajectories to them: steps 6 to 9."""
    return _decided(scene, _compare_all(scene, fits, known_rows(scene), config))


def search(
    scene: Scene, fits: Fits, followed: SearchResult, odd: Bools, excess: Floats, config: RigidConfig
) -> SearchResult:
    """Find the bodies of a scene, of which bool [N] `odd` and `excess` say what is unexplained: steps 5 to 9.

    Bodies are found in the subset. Where no cluster is one, the followed ones stand; else all trajectories
    are compared with what was found. In a small scene bodies are fitted to the trajectories that were
    assigned to them, twice.
    """
    subset = choose_subset(scene, odd, excess)
    count, labels, new = _first_bodies(scene, fits, subset, config)
    if not (new or odd.any()):
        return followed
    if not scene.small:
        rows = extended_rows(scene, subset, labels, count)
        return _decided(scene, _compare_all(scene, fits, rows, config))
    result = _compare_all(scene, fits, _assigned_rows(scene, count, labels), config)
    labels = without_sliders(result.assignment.labels, result.evidence)
    rows = _assigned_rows(scene, len(result.bodies), labels)
    return _decided(scene, _compare_all(scene, fits, rows, config))


def _decided(scene: Scene, result: SearchResult) -> SearchResult:
    """The result, in which newborn features of which place tells nothing belong to nobody."""
    labels = undecided(scene, result.assignment.labels)
    return replace(result, assignment=replace(result.assignment, labels=labels))


def _first_bodies(scene: Scene, fits: Fits, subset: Subset, config: RigidConfig) -> tuple[int, Ints, bool]:
    """How many bodies the subset has, the cheapest for each of its trajectories [n], and if any is new."""
    part = scene if scene.small else scene.of(subset.tracks)
    fits = fits if scene.small else Fits(part.frames, config)
    known, clusters = known_rows(part), cluster_rows(part, subset.unexplained)  # 5
    some = fits.of(known + clusters, still=False)  # 6
    chosen, kept = select(part, some, fits.costs(some), config)  # 7, 8
    labels = without_sliders(cheapest(kept.body, kept.outlier), kept)
    return len(chosen), labels, max(chosen) > len(known)


def _compare_all(scene: Scene, fits: Fits, rows: list[Ints], config: RigidConfig) -> SearchResult:
    """Fit bodies to rows, intp [m] each, select the best, and assign every trajectory to one of them."""
    some = fits.of(rows, still=True)  # 6
    found = fits.costs(some)  # 7
    if not scene.small:
        worth = supported(scene, some, found, config)
        some, found = [some[k] for k in worth], found.of(worth)
    chosen, kept = select(scene, some, found, config)  # 8
    return _assigned(scene, [some[k] for k in chosen], kept, config)  # 9


def _assigned(scene: Scene, some: list[Fitted], evidence: Costs, config: RigidConfig) -> SearchResult:
    """Assign every trajectory to one of the bodies that were selected."""
    frames, before, bodies = scene.frames, scene.before, [one.body for one in some]
    cost, prices = evidence.body + carried_costs(scene, some), membership_prices(scene, some, config)
    rough = cheapest(cost + prices, evidence.outlier)
    own = _own_columns(before, continued(before, rough, len(bodies), largest_total))
    # Nothing tells what rests with a resting body from the background: its membership has a price here too.
    resting = np.array([one.kept.rests for one in some])
    cost[np.ix_(scene.judged & (own == STATIC), resting)] += prices[resting]
    position = predicted_positions(frames, scene.newest, bodies, rough)
    return SearchResult(bodies, assign(frames, cost, evidence.outlier, own, position, config), evidence)


def _assigned_rows(scene: Scene, count: int, labels: Ints) -> list[Ints]:
    """Rows of the trajectories that are assigned to each of `count` bodies but the static one.

    Also those of separate hypotheses at rest: a body that is dropped later may displace them.
    """
    frames = scene.frames
    # Newborn members hold poses where few others are left.
    known = scene.judged | (scene.before != NO_HYPOTHESIS)
    telling = known & frames.telling
    found = [frames.rows_of((labels == k) & telling) for k in range(1, count)]
    for one in np.unique(scene.before[scene.resting]).tolist():
        rows = frames.rows_of((scene.before == one) & telling)
        if not any(np.array_equal(rows, other) for other in found):
            found.append(rows)
    return found


def _own_columns(before: Labels, heirs: dict[int, int]) -> Ints:
    """Column of the body that continues each trajectory's hypothesis, or -1, intp [N]."""
    found = np.full(len(before), -1, np.intp)
    for k, hypothesis in heirs.items():
        found[before == hypothesis] = k
    return found
