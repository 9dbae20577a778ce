"""One pair of hypotheses over time, and the joint between them."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from comotion_schemas.hypotheses import JointKind

from ..arrays import Floats, Stamps
from ..partition import BodyMotion
from .evidence import DEGREES, KINDS, Verdict, excess, judge
from .fitting import Fit, joint_position
from .memory import KeyStates
from .models import FixedKind, Model
from .states import States, averaged, quantiles, relative_states

JOINTS: tuple[JointKind, ...] = KINDS
# s; a joint has broken where the states of so long do not fit it: by so much per degree of freedom in the
# median, and by so many times more than the states before. With lasting errors the variance of a state is
# some 8 times that of a frame.
_RECENT = 1.0
_BROKEN = 2.0
_WORSE = 4.0
# Probability from which on a kind of joint is published.
_MIN_CONFIDENCE = 0.95
# rad and m; a pair that has turned and moved less is undetermined.
_MIN_TURN, _MIN_SHIFT = 0.2, 0.03
# rad; a pair whose axis is less well known is undetermined. Chosen on `tennis_serve`, see
# docs/research/joints.md.
_MAX_AXIS_SIGMA = 0.15
# A free body may move for a while as if it had a joint. After that it must do so for longer.
_PATIENCE_NS, _MAX_PATIENCE_NS = 3_000_000_000, 8_000_000_000
# A joint is kept until its axis is so many times less well known than a new one's.
_KEPT = 1.5
# A hinge is within so many radii of the child's features; unit of the space, least radius.
_REACH, _MIN_RADIUS = 4.0, 1e-3
# Of the local cubic that poses are published from (rigid.kinematics): its error at the newest frame, and that
# of its slope per s, are 0.82 and 4.4 times the error of a frame, and the lasting error is as large as that.
# Both in errors of a state: two frames with the lasting error of 15.
_NOW, _SLOPE = 0.46, 1.6
# s; lasting errors go with the place of a body more than with time, so a longer look adds little. Axes on
# even seeds of the workcell are then within 2.45 sigma in 88 % of the judgements.
_MAX_SECONDS = 2.0


class Sigmas(NamedTuple):
    """One-sigma of the axis (rad), a point of it (across the axis), the position now and its rate."""

    axis: float
    point: float
    position: float
    rate: float


@dataclass(frozen=True)
class Known:
    """A joint as it was judged last.

    Attributes
    ----------
    kind, confidence
        What it is, and its probability.
    sigmas
        Of its axis and position; None where it has none.
    """

    kind: JointKind = "undetermined"
    confidence: float = 0.0
    sigmas: Sigmas | None = None


@dataclass
class Pair:
    """What is known of two hypotheses.

    Attributes
    ----------
    parent, child
        Their ids.
    point
        float64 [3], the point of the child whose place is followed, in the child's axes.
    known
        The joint as it was judged last.
    models, chances
        The best fit of each kind, and how probable each was.
    judged_ns
        When it was judged last; None: never.
    range
        Least and largest position of the joint so far.
    typical_information
        float64 [6, 6], of a state of two frames.
    """

    parent: int
    child: int
    point: Floats
    known: Known = field(default_factory=Known)
    models: dict[FixedKind, Model] = field(default_factory=dict)
    chances: dict[JointKind, float] = field(default_factory=dict)
    judged_ns: int | None = None
    range: tuple[float, float] = (0.0, 0.0)
    typical_information: Floats = field(default_factory=lambda: np.eye(6))
    _keys: KeyStates = field(default_factory=KeyStates)
    # States up to here are key states, or of no account.
    _absorbed_ns: int = -(2**62)
    # The state of position 0, and where on the model it is.
    _first: States | None = None
    _zero: float = 0.0
    # Whether both have moved in the space at a time.
    _together: bool = False
    _candidate: JointKind = "undetermined"
    _patience_ns: int = 0

    @property
    def model(self) -> Model | None:
        """The joint; None where there is none."""
        kind = _joint_kind(self.known.kind)
        return None if kind is None else self.models.get(kind)

    def judge(self, parent: BodyMotion, child: BodyMotion) -> None:
        """Decide anew what the pair is."""
        stamp_ns = int(parent.stamps[-1])
        window = relative_states(parent, child, self.point)
        window = averaged(window.of(window.stamps > self._absorbed_ns))
        states = States.joined([self._keys.states, window])
        self.judged_ns = stamp_ns
        if len(window) < 2:
            return
        self._together |= _has_moved(child) and _has_moved(parent)
        self.typical_information = window.information[-1]
        reach = _REACH * max(child.radius or parent.radius, _MIN_RADIUS)
        verdict = judge(states, self.models, self.chances, reach)
        if self._broken(verdict, len(self._keys.weight), stamp_ns - window.stamps):
            self._begin_again(stamp_ns)
            return
        before = self.model
        self.models = {kind: one.model for kind, one in verdict.fits.items()}
        self.chances = verdict.probability
        rate = (len(window) - 1) / max(float(np.ptp(window.stamps)) * 1e-9, 1e-9)
        self._decide(verdict, len(states) / rate)
        model = self.model
        if model is not None:
            if before is None or before.kind != model.kind:
                self._first, self.range = states.of(slice(0, 1)), (0.0, 0.0)
            self._zero = 0.0 if self._first is None else joint_position(model, self._first)
            self._see(verdict.fits[model.kind])
        # What is about to leave the window is remembered.
        leaving = window.of(window.stamps <= parent.stamps[0] + int(_RECENT * 1e9))
        if len(leaving):
            self._keys.absorb(leaving, child.radius or parent.radius)
            self._absorbed_ns = int(leaving.stamps[-1])

    def position(self, state: States) -> float:
        """Position of one state on the joint, 0 where the pair was first seen; 0 where there is no joint."""
        model = self.model
        if model is None:
            return 0.0
        return joint_position(model, state) - self._zero

    def _decide(self, verdict: Verdict, seconds: float) -> None:
        kind, chance = verdict.best, verdict.probability[verdict.best]
        apart = verdict.turn >= _MIN_TURN or verdict.shift >= _MIN_SHIFT
        decided = self._together if kind == "fixed" else apart
        decided &= kind not in JOINTS or verdict.span_ns >= self._patience_ns
        sigmas = _sigmas(verdict, kind, seconds)
        most = _MAX_AXIS_SIGMA * (_KEPT if kind == self.known.kind else 1)
        decided &= sigmas is None or sigmas.axis <= most
        own = verdict.probability.get(self.known.kind, 0.0)
        if self.known.kind in JOINTS and kind != self.known.kind and own > 1 - _MIN_CONFIDENCE:
            # What speaks against the joint is no better than doubt.
            self.known = replace(self.known, confidence=own)
        elif decided and chance >= _MIN_CONFIDENCE:
            # A free body may for a moment move as if it had a joint.
            again = kind in (self._candidate, self.known.kind, "free")
            if kind not in JOINTS:
                self._lose()
            self.known = Known(kind, chance, sigmas) if again else Known()
        else:
            self._lose()
            self.known = Known()
        self._candidate = kind

    def _lose(self) -> None:
        """A pair that has lost a joint must show the next one for longer."""
        if self.known.kind in JOINTS:
            self._patience_ns = min(max(2 * self._patience_ns, _PATIENCE_NS), _MAX_PATIENCE_NS)

    def _see(self, fit: Fit) -> None:
        """Widen the range of the joint."""
        if fit.model.kind != "fixed":
            low, high = quantiles(fit.q - self._zero, (0.01, 0.99))
            self.range = (min(self.range[0], low), max(self.range[1], high))

    def _broken(self, verdict: Verdict, keys: int, age_ns: Stamps) -> bool:
        kind = _joint_kind(self.known.kind)
        if kind is None:
            return False
        fit = verdict.fits[kind]
        recent = np.append(np.zeros(keys, np.bool_), age_ns <= _RECENT * 1e9)
        if recent.all() or not recent.any():
            return False
        per_freedom = fit.squared / (6 - DEGREES[kind])
        (now,), (before,) = quantiles(per_freedom[recent], (0.5,)), quantiles(per_freedom[~recent], (0.5,))
        return now > max(_BROKEN, _WORSE * before)

    def _begin_again(self, stamp_ns: int) -> None:
        self._lose()
        self._keys = KeyStates()
        self.models, self.known, self._first = {}, Known(), None
        self._together = False
        self._absorbed_ns = stamp_ns - int(_RECENT * 1e9)


def _joint_kind(kind: JointKind) -> FixedKind | None:
    return next((one for one in KINDS if one == kind), None)


def _sigmas(verdict: Verdict, kind: JointKind, seconds: float) -> Sigmas | None:
    """One-sigma of a joint; `seconds` is how long its states were seen for in all."""
    movable = _joint_kind(kind)
    if movable is None or movable == "fixed":
        return None
    fit = verdict.fits[movable]
    variance = np.diag(fit.covariance) * excess(fit) * max(seconds / _MAX_SECONDS, 1.0)
    point = variance[6:8] if kind == "revolute" else variance[3:6]
    (frame,) = quantiles(fit.q_sigma, (0.5,))
    return Sigmas(
        float(np.sqrt(variance[8:].mean())), float(np.sqrt(point.mean())), _NOW * frame, _SLOPE * frame
    )


def _has_moved(body: BodyMotion) -> bool:
    """Whether a body has moved in the space, within the window."""
    if body.static or not body.posed.any():
        return False
    R, place = body.R[body.posed], body.R[body.posed] @ body.centre + body.t[body.posed]
    chord = np.sqrt(np.maximum(3 - np.einsum("nij,ij->n", R, R[-1]), 0)).max()
    shift = float(np.linalg.norm(place - place[-1], axis=1).max())
    return bool(chord >= _MIN_TURN or shift >= _MIN_SHIFT)
