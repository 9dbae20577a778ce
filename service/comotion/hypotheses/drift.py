"""Finds the sources of a space whose offset from the others changes.

Sources of a space see each body move by one motion, up to a small turn, shift and delay of each source that
last: its offset. Where these change, and so in all bodies alike, a source drifts: what carries it moves, or
its clock runs away. A body that moves otherwise for one source alone is no drift: bodies split.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Ints, Labels, Slots, Stamps, Table, find, ranks
from ..geometry.body import pose_columns
from ..partition import NO_HYPOTHESIS
from ..trajectories.window import Window

# ns: what is compared is the motion over the first time, up to the second one before the watermark, when slow
# sources, too, have observed something; velocities are taken over the third.
_SPAN_NS, _LAG_NS, _STEP_NS = 4_000_000_000, 300_000_000, 200_000_000
# ns; between observations farther apart, bodies turn and swing by more than noise.
_DENSE_NS = 100_000_000
# ns between two looks; so many in a row find a drift, which lasts for as many more.
_EVERY_NS, _LOOKS, _MORE_LOOKS = 500_000_000, 2, 4
# Bodies that two sources share, and features of the one that are compared on each, at least and at most.
_MIN_BODIES, _MIN_FEATURES, _MAX_FEATURES = 2, 2, 16
# Prior standard deviations of an offset, as in registration: rad, share of the extent, s; and how many times
# as much it may change.
_ROTATION, _SHIFT, _DELAY = 0.035, 0.03, 0.02
_CHANGE = 10.0
# What a change must explain, in variances of noise for each of its unknowns, and what it may leave for each
# coordinate.
_CLEAR, _LEFT = 4.0, 6.0
# Others agree on a body where its variance of noise is at most so many times that of the calmest, or so large
# a share of the extent squared.
_AGREE, _EXACT = 16.0, 1e-10


@dataclass(frozen=True)
class _Motions(Table):
    """Of K hypotheses x1 = R x0 + t, squared residual, degrees of freedom left, and features that tell it."""

    label: Labels
    R: Floats
    t: Floats
    squared: Floats
    freedom: Ints
    features: Ints


# Of N trajectories: positions and velocities at the beginning and the end, session and hypothesis.
_Seen = NDArray[Any]
_VECTORS = "first", "last", "first_speed", "last_speed"


@dataclass
class DriftCheck:
    """Follows the sources of one space, without those of which `mistimed` has the session numbers.

    Where a clock is known to be wrong, nobody can tell which of two sources has moved.
    """

    mistimed: Sequence[int] = ()
    # Times, keys and hypotheses of the last looks.
    _looks: deque[tuple[int, Stamps, Labels]] = field(default_factory=deque)
    # By session number: looks in a row with a drift; after so many the looks that it lasts too.
    _counts: dict[int, int] = field(default_factory=dict)

    @property
    def drifting(self) -> list[int]:
        """Numbers of the sessions that drift, ascending."""
        return sorted(number for number, looks in self._counts.items() if looks >= _LOOKS)

    def look(self, window: Window, current: Slots, stamp_ns: int, delays_ns: Mapping[int, int]) -> None:
        """Compare what sources see of the current slots intp [n].

        `delays_ns` is to be added to the times of session numbers: of a source whose delay is long the
        velocities would not tell it.
        """
        if self._looks and 0 <= stamp_ns - self._looks[-1][0] < _EVERY_NS:
            return
        current = current[~np.isin(window.source[current], self.mistimed)]
        # What has parted since is a question: what was one body before?
        while len(self._looks) > 1 and self._looks[1][0] <= stamp_ns - _LAG_NS - _SPAN_NS:
            self._looks.popleft()
        present = set(np.unique(window.source[current]).tolist())
        drifting = present.intersection(self.drifting)
        apart = set(drifting)
        if self._looks and len(present) > 1:
            seen = _seen(window, current, *self._looks[0][1:], stamp_ns - _LAG_NS, delays_ns)
            apart = _judged(seen, drifting)
        self._looks.append((stamp_ns, window.key[current], window.label[current]))
        lasting = {number: self._counts[number] - 1 for number in drifting}
        again = {number: self._counts.get(number, 0) + 1 for number in apart}
        most = _LOOKS + _MORE_LOOKS - 1
        self._counts = lasting | {n: looks if looks < _LOOKS else most for n, looks in again.items()}


def _seen(
    window: Window,
    current: Slots,
    keys: Stamps,
    labels: Labels,
    stamp_ns: int,
    delays_ns: Mapping[int, int],
) -> _Seen:
    """Current trajectories that had a hypothesis, by their keys and hypotheses then."""
    order = np.argsort(keys)
    at = find(window.key[current], keys[order])
    slots, label = current[at >= 0], labels[order][at[at >= 0]]
    slots, label = slots[label != NO_HYPOTHESIS], label[label != NO_HYPOTHESIS]
    # What one source sees of one body; the first of these features.
    views = label * (window.source.max(initial=0) + 1) + window.source[slots]
    few = ranks(views, window.key[slots]) < _MAX_FEATURES
    slots, label = slots[few], label[few]
    first_ns = stamp_ns - _SPAN_NS
    stamps = np.array([first_ns, first_ns + _STEP_NS, stamp_ns - _STEP_NS, stamp_ns])
    vectors = [(name, np.float64, window.dim) for name in _VECTORS]
    seen = np.zeros(len(slots), [*vectors, ("source", np.intp), ("label", np.int64)])
    held = np.zeros(len(slots), np.bool_)
    seen["source"], seen["label"], step_s = window.source[slots], label, _STEP_NS * 1e-9
    for number in np.unique(seen["source"]).tolist():
        own = seen["source"] == number
        states = window.states_at(slots[own], stamps - delays_ns.get(number, 0), _DENSE_NS)
        x, held[own] = states.position, states.held.all(0)
        seen["first"][own], seen["last"][own] = x[0], x[3]
        seen["first_speed"][own], seen["last_speed"][own] = (x[1] - x[0]) / step_s, (x[3] - x[2]) / step_s
    return seen[held]


def _judged(seen: _Seen, drifting: Collection[int]) -> set[int]:
    """Sessions that drift, of which some did so until now; who cannot be judged is as it was.

    Of those apart from all others the clearest one drifts; then the rest is compared without it. Of two
    nobody knows; that which sees the calmest body move less is believed.
    """
    judged = set(drifting)
    while True:
        rest = seen[~np.isin(seen["source"], list(judged))]
        views = {number: rest["source"] == number for number in np.unique(rest["source"]).tolist()}
        gains = {number: _gain(_motions(rest[~own]), rest[own]) for number, own in views.items()}
        apart = {number: gain for number, gain in gains.items() if gain >= 1}
        if not apart:
            break
        if len(gains) == 2:
            apart = {number: _calmest(rest[own]) for number, own in views.items()}
        judged.add(max(apart, key=lambda number: apart[number]))
    if not drifting:
        return judged
    motions = _motions(rest)
    return judged - {number for number in drifting if _gain(motions, seen[seen["source"] == number]) < 1}


def _motions(seen: _Seen) -> _Motions:
    """Of each hypothesis that enough features tell, the rigid motion that fits best (Kabsch)."""
    dim = seen["first"].shape[1]
    names, row, counts = np.unique(seen["label"], return_inverse=True, return_counts=True)
    share = (row == np.arange(len(names))[:, None]) / counts[:, None]
    middle, now = share @ seen["first"], share @ seen["last"]
    first, last = seen["first"] - middle[row], seen["last"] - now[row]
    U, _, V = np.linalg.svd((share[:, None] * first.T) @ last)
    V[:, -1] *= np.sign(np.linalg.det(U @ V))[:, None]
    R = (U @ V).transpose(0, 2, 1)
    t = now - np.einsum("kij,kj->ki", R, middle)
    squares = ((np.einsum("nij,nj->ni", R[row], first) - last) ** 2).sum(1)
    squared = np.asarray(np.bincount(row, squares, len(names)), np.float64)
    freedom = counts * dim - dim * (dim + 1) // 2
    return _Motions(names, R, t, squared, freedom, counts).of(counts > dim)


def _gain(motions: _Motions, seen: _Seen) -> float:
    """What a change of a source's offset explains by the motions that others see: 1 is clear.

    NaN where they share too little, or where no change explains the difference.
    """
    names, counts = np.unique(seen["label"], return_counts=True)
    enough = np.isin(motions.label, names[counts >= _MIN_FEATURES])
    shared = _agreed(motions.of(enough), seen["first"])
    if len(shared) < _MIN_BODIES:
        return np.nan
    seen = seen[np.isin(seen["label"], shared.label)]
    centre = seen["first"].mean(0)
    extent = float(np.sqrt(((seen["first"] - centre) ** 2).sum(1).mean()))
    row = (seen["label"][:, None] == shared.label).argmax(1)
    R, t = shared.R[row], shared.t[row]
    apart = seen["last"] - np.einsum("nij,nj->ni", R, seen["first"]) - t
    first_offsets = _offsets(seen["first"], seen["first_speed"], centre)
    last_offsets = _offsets(seen["last"], seen["last_speed"], centre)
    lasting = last_offsets - R @ first_offsets
    # That of the worse side: thousands of exact features do not make the others exact.
    squares = [side.squared.sum() / max(side.freedom.sum(), 1) for side in (shared, _motions(seen))]
    noise = float(np.sqrt(max(squares))) + 1e-9 * extent
    dim = len(centre)
    prior = np.repeat([_ROTATION, _SHIFT * extent, _DELAY], [2 * dim - 3, dim, 1]) / noise
    e, J0, J1 = apart.ravel() / noise, lasting.reshape(apart.size, -1), last_offsets.reshape(apart.size, -1)
    constant = _least_cost(e, J0 * prior)
    changing = _least_cost(e, np.hstack([J0 * prior, J1 * prior * _CHANGE]))
    # The fewer features tell the motions, the more their errors look like a change.
    clear = _CLEAR * len(prior) * (1 + 2 * len(seen) / shared.features.sum())
    return float((constant - changing) / clear) if changing < _LEFT * len(e) else np.nan


def _agreed(motions: _Motions, places: Floats) -> _Motions:
    """Bodies that others see move as one, in a scene of places [n, dim].

    Where they disagree one of them may be right: what they see together is no measure for another.
    """
    if not len(motions):
        return motions
    noise = motions.squared / np.maximum(motions.freedom, 1)
    return motions.of(noise <= max(_AGREE * noise.min(), _EXACT * float(places.var(0).sum())))


def _offsets(places: Floats, speeds: Floats, centre: Floats) -> Floats:
    """Derivatives of places [n, dim] by turn, shift and delay, float64 [n, dim, p]."""
    dim = len(centre)
    arm = np.zeros((len(places), 3))
    arm[:, :dim] = places - centre
    turn_and_shift = pose_columns(arm, 3)[:, :dim, 6 - 2 * dim : 3 + dim]
    return np.concatenate([turn_and_shift, speeds[:, :, None]], 2)


def _least_cost(e: Floats, J: Floats) -> float:
    """Least |e - J x|^2 + |x|^2."""
    x = np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ e)
    return float(e @ (e - J @ x))


def _calmest(seen: _Seen) -> float:
    """Mean squared displacement of the body that moves least, as one source sees it."""
    squared = ((seen["last"] - seen["first"]) ** 2).sum(1)
    bodies = (squared[seen["label"] == body] for body in np.unique(seen["label"]))
    return min((float(body.mean()) for body in bodies if len(body) >= _MIN_FEATURES), default=np.inf)
