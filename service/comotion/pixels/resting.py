"""Follows which body each trajectory belongs to, while the background rests before the camera.

Before a camera that moves it is made to rest first, where it moves smoothly (:mod:`.steadying`).
"""

import numpy as np

from ..arrays import Bools, Labels
from ..trajectories.window import Window
from .belief import BACKGROUND, Belief
from .gains import rest_gain, steadiness
from .recent import Recent, recent_motion
from .steadying import Steadying

# ns between two instants at which motion is taken in, however often updates are made.
_STEP_NS = 100_000_000
# Share of the picture at rest above which the camera rests: something large may move before it.
_LEAST_SHARE = 0.2
# Change of the evidence per share beyond, and its limits: per step, and in all.
_WEIGHT, _FALL, _RISE, _MOST = 10.0, -3.0, 1.0, 5.0
# Before a camera that moves, the background is followed in windows longer than this, or once the structure of
# the largest hypothesis has explained it, and no other, up to a share, for so many steps: before, the window
# tells more.
_LONG_NS, _DISAGREE, _AGREED_STEPS = 4_500_000_000, 0.1, 5
# A body that is older has not begun to move with the camera: that shows in less.
_BEGINS_NS = 1_000_000_000
# Fewer trajectories do not show whether the camera rests.
_LEAST_TRACKS = 5


class RestingCamera:
    """Follows one camera and, while its background rests, the belief which trajectories move with which body.

    Attributes
    ----------
    carried
        Whether the camera moved at the last step.
    """

    def __init__(self) -> None:
        self.carried = False
        self._agreed = 0
        # That the camera rests, and that the background does once its motion is subtracted.
        self._evidence, self._steady = 0.0, 0.0
        self._steadying = Steadying()
        self._stamp_ns: int | None = None
        self._belief: Belief | None = None

    def advance(self, window: Window, stamp_ns: int, labels: Labels) -> Belief | None:
        """Take in what was observed up to an instant; the belief, None while nothing shows a background.

        Parameters
        ----------
        window
            Store of all trajectories, in which something was observed.
        stamp_ns
            The watermark.
        labels
            int64 [capacity]; hypotheses of the slots so far, negative for none: a belief begins with them.
        """
        begin = window.instants[0]
        last = min(stamp_ns, window.instants[-1])
        # After a gap the window begins later than the last step.
        first = max(self._stamp_ns or begin, last - window.span_ns, begin)
        count = max(round((last - first) / _STEP_NS), int(self._stamp_ns is None or last > first))
        for instant in (first + (last - first) * k // count for k in range(1, count + 1)):
            recent = recent_motion(window, instant)
            movers: Bools | np.bool_ = np.False_
            if self._belief is not None:
                self._belief.admit(window)
                known = self._belief.older_than(instant - _BEGINS_NS)
                movers = np.isin(self._belief.labels(recent.slots), known)
            self._evidence = _judged(recent, self._evidence, movers)
            began, self.carried = self.carried and self._belief is not None, self._evidence < 0
            if self.carried:
                recent = self._steadied(window, recent, labels)
                early = self._agreed < _AGREED_STEPS and instant - begin < _LONG_NS
                if self._steady < 0 or (early and not began):
                    self._belief = None
                    continue
            self._belief = self._belief or Belief(window, labels, recent.slots[rest_gain(recent) > 0])
            self._belief.step(window, recent, instant, carried=self.carried)
        self._stamp_ns = max(last, first)
        return self._belief

    def _steadied(self, window: Window, recent: Recent, labels: Labels) -> Recent:
        """Motion relative to that of the background; and note whether that shows it at rest."""
        own, bodies = labels[recent.slots], np.full(len(recent.slots), BACKGROUND)
        if self._belief is not None:
            bodies = self._belief.labels(recent.slots)
        recent = self._steadying.steadied(recent, window.key[recent.slots], bodies)
        ids, counts = np.unique(own[own >= 0], return_counts=True)
        largest = own == (ids[counts.argmax()] if len(ids) else -1)
        # What the window has not named yet neither agrees nor disagrees.
        agree = ((rest_gain(recent) > 0) == largest)[own >= 0]
        self._agreed = self._agreed + 1 if agree.sum() > (1 - _DISAGREE) * len(agree) else 0
        fallen = max(self._steady + _FALL, -_MOST)
        self._steady = _judged(recent, self._steady) if self._steadying.rigid else fallen
        return recent


def _judged(recent: Recent, evidence: float, movers: Bools | np.bool_ = np.False_) -> float:
    """The evidence that the camera rests, with what a step adds by the share of the picture that rests.

    Not by that of the trajectories: a person before bare walls has most of them. `movers`, bool [n], of
    bodies that moved before the camera may have begun to, do not count.
    """
    seen = recent.seen.any(axis=0) & ~movers
    if seen.sum() < _LEAST_TRACKS:
        return evidence
    cells = (recent.position[seen] / max(recent.reach, 1.0)).astype(int)
    cell = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    share = float((np.bincount(cell, steadiness(recent)[seen]) / np.bincount(cell)).mean())
    change = min(max(_WEIGHT * (share - _LEAST_SHARE), _FALL), _RISE)
    return min(max(evidence + change, -_MOST), _MOST)
