"""One pair of hypotheses over time, and the joint between them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from comotion_schemas import Joint
from comotion_schemas.hypotheses import JointKind

from ..arrays import Floats, Stamps, quantiles
from ..partition import BodyMotion
from .models import KINDS, Fit, Model, joint_position, judge, principal
from .states import States, averaged, key_states, relative_states, turns_between

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
# A hinge is within so many radii of the child's features; unit of the space, least radius.
_REACH, _MIN_RADIUS = 4.0, 1e-3
# Of the local cubic that poses are published from (geometry.kinematics): its error at the newest frame, and
# that of its slope per s, are 0.82 and 4.4 times the error of a frame, and the lasting error is as large as
# that. Both in errors of a state: two frames with the lasting error of 15.
_NOW, _SLOPE = 0.46, 1.6
# s; lasting errors go with the place of a body more than with time, so a longer look adds little. Axes on
# even seeds of the workcell are then within 2.45 sigma in 88 % of the judgements.
_MAX_SECONDS = 2.0
_SIGMAS = "sigma_axis", "sigma_point", "sigma_position", "sigma_rate"
# States; residuals farther apart are taken to be independent: pairs of frames over two seconds.
_LAGS = 15


@dataclass
class Pair:
    """What is known of two hypotheses."""

    joint: Joint
    """The joint as it was judged last, without where it is."""
    point: Floats
    """float64 [3], the point of the child whose place is followed, in the child's axes."""
    models: dict[JointKind, Model] = field(default_factory=dict)
    """The best fit of each kind."""
    range: tuple[float, float] = (0.0, 0.0)
    """Least and largest position of the joint so far."""
    zero: float = 0.0
    """Where on the model position 0 is: there the pair was first seen."""
    typical_information: Floats = field(default_factory=lambda: np.eye(6))
    """float64 [6, 6], of a state of two frames."""
    # What the window has left.
    _keys: States = field(default_factory=States.empty)
    # States up to here are key states, or of no account.
    _absorbed_ns: int = -(2**62)
    # The state of position 0.
    _first: States | None = None
    # Whether both have moved in the space at a time.
    _together: bool = False
    _candidate: JointKind = "undetermined"
    _patience_ns: int = 0

    @classmethod
    def of(cls, parent: int, child: int, space: str, point: Floats) -> Self:
        """Build a pair of which nothing is known yet."""
        unknown = Joint(parent=parent, child=child, space=space, kind="undetermined", confidence=0.0)
        return cls(unknown, point)

    @property
    def model(self) -> Model | None:
        """The joint; None where there is none."""
        return self.models[self.joint.kind] if self.joint.kind in KINDS else None

    def judge(self, parent: BodyMotion, child: BodyMotion) -> None:
        """Decide anew what the pair is."""
        stamp_ns = int(parent.stamps[-1])
        window = relative_states(parent, child, self.point)
        window = averaged(window.of(window.stamps > self._absorbed_ns))
        states = self._keys.joined(window)
        if len(window) < 2:
            return
        self._together = self._together or (_has_moved(child) and _has_moved(parent))
        self.typical_information = window.information[-1]
        radius = child.radius or parent.radius
        fits, chances = judge(states, self.models, _REACH * max(radius, _MIN_RADIUS))
        if self.joint.kind in KINDS and self._broken(fits[self.joint.kind], stamp_ns - window.stamps):
            self._begin_again(stamp_ns)
            return
        last = self.joint.kind
        self.models = {kind: fitted.model for kind, fitted in fits.items()}
        rate = (len(window) - 1) / max(float(np.ptp(window.stamps)) * 1e-9, 1e-9)
        self._decide(states, fits, chances, len(states) / rate)
        if self.joint.kind in KINDS:
            if last != self.joint.kind:
                self._first, self.range = states.of(slice(0, 1)), (0.0, 0.0)
            fit = fits[self.joint.kind]
            self.zero = 0.0 if self._first is None else joint_position(fit.model, self._first)
            if fit.model.kind != "fixed":
                low, high = quantiles(fit.q - self.zero, (0.01, 0.99))
                self.range = (min(self.range[0], low), max(self.range[1], high))
        # What is about to leave the window is remembered.
        leaving = window.of(window.stamps <= parent.stamps[0] + int(_RECENT * 1e9))
        if len(leaving):
            self._keys = key_states(self._keys.joined(leaving), radius)
            self._absorbed_ns = int(leaving.stamps[-1])

    def _decide(
        self,
        states: States,
        fits: Mapping[JointKind, Fit],
        chances: Mapping[JointKind, float],
        seconds: float,
    ) -> None:
        """Take up the most probable kind, where enough speaks for it; states are of so many `seconds`."""
        kind, last = max(chances, key=lambda name: chances[name]), self.joint.kind
        own = chances.get(last, 0.0)
        decided = chances[kind] >= _MIN_CONFIDENCE and (
            self._together if kind == "fixed" else _apart(states.R, fits["fixed"].model.R0, states.p)
        )
        sigmas = _sigmas(fits[kind], seconds) if kind in fits and kind != "fixed" else {}
        if kind in fits:
            decided &= int(np.ptp(states.stamps)) >= self._patience_ns
            decided &= sigmas.get("sigma_axis", 0.0) <= _MAX_AXIS_SIGMA
        if last in KINDS and kind != last and own > 1 - _MIN_CONFIDENCE:
            # What speaks against the joint is no better than doubt.
            self.joint = replace(self.joint, confidence=own)
        else:
            if not decided or kind not in KINDS:
                self._lose()
            # A free body may for a moment move as if it had a joint.
            if decided and kind in (self._candidate, last, "free"):
                self._take_up(kind, chances[kind], sigmas)
            else:
                self._take_up("undetermined", 0.0, {})
        self._candidate = kind

    def _take_up(self, kind: JointKind, confidence: float, sigmas: dict[str, float]) -> None:
        errors: dict[str, Any] = dict.fromkeys(_SIGMAS) | sigmas
        self.joint = replace(self.joint, kind=kind, confidence=confidence, **errors)

    def _lose(self) -> None:
        """A pair that has lost a joint must show the next one for longer."""
        if self.joint.kind in KINDS:
            self._patience_ns = min(max(2 * self._patience_ns, _PATIENCE_NS), _MAX_PATIENCE_NS)

    def _broken(self, fit: Fit, age_ns: Stamps) -> bool:
        """Whether the last states of the window, of an age int64 [n] each, fit far worse than all others."""
        recent = np.append(np.zeros(len(self._keys), np.bool_), age_ns <= _RECENT * 1e9)
        if recent.all() or not recent.any():
            return False
        per_freedom = fit.squared / fit.model.freedom
        (now,), (earlier,) = quantiles(per_freedom[recent], (0.5,)), quantiles(per_freedom[~recent], (0.5,))
        return now > max(_BROKEN, _WORSE * earlier)

    def _begin_again(self, stamp_ns: int) -> None:
        self._lose()
        self._keys = States.empty()
        self.models, self._first = {}, None
        self._take_up("undetermined", 0.0, {})
        self._together = False
        self._absorbed_ns = stamp_ns - int(_RECENT * 1e9)


def _sigmas(fit: Fit, seconds: float) -> dict[str, float]:
    """One-sigma of a joint that moves, as it is published; `seconds` is how long its states were seen for."""
    variance = np.diag(fit.covariance) * _excess(fit) * max(seconds / _MAX_SECONDS, 1.0)
    point = variance[6:8] if fit.model.kind == "revolute" else variance[3:6]
    (frame,) = quantiles(fit.q_sigma, (0.5,))
    axis, place = float(np.sqrt(variance[8:].mean())), float(np.sqrt(point.mean()))
    return dict(zip(_SIGMAS, (axis, place, _NOW * frame, _SLOPE * frame), strict=True))


def _excess(fit: Fit) -> float:
    """How many times wider than its covariance a fit is: residuals that are large and last have few samples.

    Their mean square, times the integrated autocorrelation time by a Bartlett window (Newey and West 1987);
    not below 1.
    """
    count = len(fit.residual)
    lags = np.arange(1, min(_LAGS, count // 3) + 1)
    square = float((fit.residual**2).sum())
    if not len(lags) or square <= 0:
        return 1.0
    shares = [float((fit.residual[k:] * fit.residual[:-k]).sum()) / square for k in lags.tolist()]
    time = 1 + 2 * float(((1 - lags / (lags[-1] + 1)) * shares).sum())
    return max(square / count / fit.model.freedom * max(time, 1.0), 1.0)


def _span(vectors: Floats) -> float:
    """Extent of vectors [n, 3] from end to end, nearly, along their principal direction."""
    low, high = quantiles(vectors @ principal(vectors - vectors.mean(0)), (0.02, 0.98))
    return high - low


def _has_moved(body: BodyMotion) -> bool:
    """Whether a body has moved in the space, within the window."""
    if body.static or not body.posed.any():
        return False
    R = body.R[body.posed]
    return _apart(R, R[-1], R @ body.centre + body.t[body.posed])


def _apart(R: Floats, near: Floats, places: Floats) -> bool:
    """Whether orientations [n, 3, 3] about a `near` one, or places [n, 3], differ enough to show a joint."""
    return _span(turns_between(R, near)) >= _MIN_TURN or _span(places) >= _MIN_SHIFT
