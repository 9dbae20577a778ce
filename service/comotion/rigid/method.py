"""The default method (``method = "comotion"``): a hypothesis is a rigid body with a motion.

The method groups trajectories by the rigid bodies that explain their motion. All lengths are relative to the
noise or to the extent of the scene, so that no parameter has a scale. The steps of an update are:

1.  Read the trajectories of the window (:mod:`.tracks`). Where the last fit explains what is new, it is held
    (:mod:`.continuation`), and step 10 follows.
2.  Register the sources: correct their extrinsics and clocks by bodies that two of them see
    (:mod:`.registration`).
3.  Resample the trajectories on common frames (:mod:`.resampling`).
4.  Estimate the noise of each, and the tolerance that deformation adds to it (:mod:`.noise`).
5.  Choose the trajectories to search, all of them in a small scene (:mod:`.subset`), and find candidates: the
    previous hypotheses, and clusters of the normalised deviation of distances (:mod:`.candidates`).
6.  Fit a body with a pose in each frame to each candidate (:mod:`.fits`, :mod:`comotion.geometry`). Once
    clusters are sorted out, it has one pose for each rest of it (:func:`~comotion.geometry.body.settled`).
7.  Compute what each trajectory costs under each body (:mod:`.costs`).
8.  Select the bodies of least total cost (:mod:`.selection`).
9.  Assign every trajectory to a body (:mod:`.assignment`).
10. Describe the motion of each body (:mod:`.motions`).
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Labels, Slots, Stamps
from ..config import FusionConfig
from ..geometry.frames import RENEWED, SELDOM, Frames
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
from .assignment import SearchResult, posterior, same_body
from .belief import Belief
from .continuation import FIRST_HELD, MOST_HELD, Fit, held, judged
from .fits import Fits
from .motions import anchored_motions, describe_bodies
from .noise import NoiseEstimates
from .registration import Registration
from .resampling import make_frames
from .search import follow, has_news, search
from .subset import Scene, unexplained
from .tracks import Tracks, read_tracks


class RigidMethod(Method):
    """The rigid-motion method for one space in a metric (or any Euclidean) unit.

    Parameters
    ----------
    config
        `rigid` and `window` matter here.
    spec
        The space.
    """

    def __init__(self, config: FusionConfig, spec: SpaceSpec) -> None:
        self._config = config.rigid
        self._dim = spec.dim
        self._registration = Registration()
        self._noise = NoiseEstimates(spec.dim)
        self._belief = Belief()
        self._chances: Floats = np.zeros((0, 1))
        self._last: Fit | None = None
        # When bodies were last searched; and by key of an unexplained trajectory, when it last caused a
        # search.
        self._searched_ns = 0
        self._searched_for: dict[int, int] = {}

    @property
    def delays_ns(self) -> Mapping[int, int]:
        """Delay that is added to the times of each source that stamps late, ns, by session number."""
        offsets = self._registration.offsets.items()
        return {source: round(offset.delay * 1e9) for source, offset in offsets if offset.late}

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories.

        Without `searching` the known bodies are fitted and the trajectories assigned to them: neither new
        bodies nor the offsets of sources are sought.
        """
        tracks = read_tracks(window, current, stamp_ns)  # 1
        if not len(tracks.key):
            return self._nothing()
        fit = self._held(window, tracks, stamp_ns, previous)
        fit = fit or self._fitted(window, tracks, stamp_ns, previous)
        self._last, tracks, labels = fit, fit.tracks, fit.result.assignment.labels
        described = describe_bodies(tracks, fit.frames, fit.result)  # 10
        chosen = np.searchsorted(tracks.key, window.key[current])
        self._chances = chances = posterior(fit.result.assignment.cost[chosen])
        confidence = chances[np.arange(len(chosen)), labels[chosen] + 1]
        position = tracks.newest[chosen, : self._dim]
        observed = np.flatnonzero(tracks.stop > tracks.start)
        deciding = np.ones(len(observed), np.bool_)
        return Partition(tracks.slot[observed], labels[observed], deciding, confidence, position, described)

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
        bodies = {h: (k, references[h]) for k, h in enumerate(ids.tolist()) if h in references}
        terms = self._last.tracks, self._last.frames, self._last.result
        return anchored_motions(*terms, {h: bodies[h] for h in wanted if h in bodies})

    def state(self) -> dict[str, Any]:
        """The offsets of the sources, and the memory of hypotheses."""
        return {"offsets": self._registration.state(), "belief": self._belief.state()}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; all else is read from the window."""
        del window
        if state:
            self._registration.load(state["offsets"])
            self._belief.load(state["belief"])

    def _held(self, window: Window, now: Tracks, stamp_ns: int, previous: Previous) -> Fit | None:
        """The last result carried over, or None where it does not explain the new observations."""
        if self._last is None:
            return None
        outlying_keys = np.array(sorted(self._searched_for), np.int64)
        fit = held(self._last, window, now, stamp_ns, outlying_keys)
        if fit is None or not (self.searching and self._long_ago(fit.frames)):
            return fit
        hypotheses = np.where(
            fit.tracks.stop > fit.tracks.start, previous.labels[fit.tracks.slot], NO_HYPOTHESIS
        )
        scene = self._scene(fit.tracks, fit.frames, hypotheses, previous)
        if has_news(scene, fit.result):
            return None
        self._searched_ns = stamp_ns
        return fit

    def _scene(self, tracks: Tracks, frames: Frames, hypotheses: Labels, previous: Previous) -> Scene:
        # A fit that is held says nothing new about its bodies: it is learned from when it is compared.
        if self._last is not None and len(previous.ids) == len(self._last.result.bodies):
            self._belief.learn(self._last.result, self._last.frames, previous.ids)
        static = int(previous.ids[0]) if len(previous.ids) and previous.ids[0] != NO_HYPOTHESIS else None
        return self._belief.scene(frames, tracks.newest, hypotheses, static)

    def _fitted(self, window: Window, tracks: Tracks, stamp_ns: int, previous: Previous) -> Fit:
        """The result of steps 2 to 9."""
        tracks = self._registration.correct(tracks.timed())  # 2
        spans = window.span_ns, window.gap_ns
        frames = make_frames(tracks, self._noise, stamp_ns, *spans, self._config)  # 3, 4
        scene = self._scene(tracks, frames, previous.labels[tracks.slot], previous)
        result, news = self._grouped(scene)  # 5 to 9
        if self.searching:
            self._registration.learn(tracks, frames, result.assignment.labels)  # 2, for the next fit
        longest = MOST_HELD if scene.small else SELDOM
        holds = FIRST_HELD if news or self._last is None else min(2 * self._last.holds, longest)
        return Fit(tracks, frames, result, stamp_ns, judged(frames), holds)

    def _grouped(self, scene: Scene) -> tuple[SearchResult, bool]:
        """The bodies and their trajectories, and whether there are new bodies."""
        fits = Fits(scene.frames)
        followed = follow(scene, fits)
        outlying = unexplained(scene, followed)
        if not (self.searching and self._due(scene, scene.frames.key[outlying])):
            return followed, False
        result = search(scene, fits, followed, outlying)
        return result, result is not followed

    def _due(self, scene: Scene, outlying_keys: Stamps) -> bool:
        """Whether to search for new bodies: if a trajectory is newly unexplained, and else now and then.

        Within that share of the window the same unexplained trajectory does not cause another search.
        `outlying_keys` int64 [n] are the keys of the unexplained trajectories.
        """
        stamps, searched = scene.frames.stamps, self._searched_for
        now_ns, span_ns = int(stamps[-1]), int(stamps[-1] - stamps[0])
        self._searched_for = {key: ns for key, ns in searched.items() if now_ns - ns < RENEWED * span_ns}
        if self._long_ago(scene.frames) or not self._searched_for.keys() >= set(outlying_keys.tolist()):
            self._searched_ns = now_ns
            self._searched_for |= dict.fromkeys(outlying_keys.tolist(), now_ns)
            return True
        return False

    def _long_ago(self, frames: Frames) -> bool:
        """Whether bodies were last searched longer ago than a share of the window."""
        span_ns = frames.stamps[-1] - frames.stamps[0]
        share = MOST_HELD if self._last is None else min(self._last.holds, MOST_HELD)
        return bool(frames.stamps[-1] - self._searched_ns >= share * span_ns)

    def _nothing(self) -> Partition:
        self._belief.forget()
        self._last, self._chances = None, np.zeros((0, 1))
        no_slots = np.zeros(0, np.intp)
        return Partition(no_slots, no_slots, np.zeros(0, np.bool_), np.zeros(0), np.zeros((0, self._dim)))
