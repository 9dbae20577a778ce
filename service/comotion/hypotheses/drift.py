"""Finds the sources of a space whose offset from the others changes.

Sources of a space see each body move by one motion, up to a small turn, shift and delay of each source that
last: its offset. Where these change, and so in all bodies alike, a source drifts: what carries it moves, or
its clock runs away. A body that moves otherwise for one source alone is no drift: bodies split.
"""

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats, Labels, Slots, Stamps, find, ranks
from ..partition import NO_HYPOTHESIS
from ..trajectories.interpolation import states_at
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


class _Motion(NamedTuple):
    """x1 = R x0 + t, the squared residual, the degrees of freedom left, and how many features tell."""

    R: Floats
    t: Floats
    squared: float
    freedom: int
    features: int


@dataclass(frozen=True)
class _Seen:
    """Of N trajectories: positions and velocities then and now, float64 [N, dim]; session and hypothesis."""

    before: Floats
    after: Floats
    speed_before: Floats
    speed_after: Floats
    source: Slots
    label: Labels

    def where(self, rows: Bools) -> "_Seen":
        return _Seen(**{name: column[rows] for name, column in vars(self).items()})

    def by(self, sources: Collection[int], *, others: bool = False) -> "_Seen":
        """What some sources see, or all `others`."""
        return self.where(np.isin(self.source, list(sources), invert=others))


@dataclass
class DriftCheck:
    """Follows the sources of one space, without those of which `mistimed` has the session numbers.

    Where a clock is known to be wrong, nobody can tell which of two sources has moved.
    """

    mistimed: frozenset[int] = frozenset()
    # Times, keys and hypotheses of the last looks.
    _looks: deque[tuple[int, Stamps, Labels]] = field(default_factory=deque)
    # By session number: looks in a row that have found a drift; after so many the looks that it lasts too.
    _found: dict[int, int] = field(default_factory=dict)

    @property
    def drifting(self) -> list[int]:
        """Numbers of the sessions that drift, ascending."""
        return sorted(one for one, looks in self._found.items() if looks >= _LOOKS)

    def look(
        self, window: Window, current: Slots, labels: Labels, stamp_ns: int, delays_ns: Mapping[int, int]
    ) -> None:
        """Compare what sources see.

        Parameters
        ----------
        current
            intp [n], slots of the current trajectories.
        labels
            int64 [capacity], hypothesis of each slot.
        stamp_ns
            The watermark.
        delays_ns
            Of session numbers, what is to be added to their times: of a source whose delay is long the
            velocities would not tell it.
        """
        if self._looks and 0 <= stamp_ns - self._looks[-1][0] < _EVERY_NS:
            return
        current = current[~np.isin(window.source[current], list(self.mistimed))]
        # What has parted since is a question: what was one body before?
        while len(self._looks) > 1 and self._looks[1][0] <= stamp_ns - _LAG_NS - _SPAN_NS:
            self._looks.popleft()
        here = set(np.unique(window.source[current]).tolist())
        known = here.intersection(self.drifting)
        found = set(known)
        if self._looks and len(here) > 1:
            seen = _seen(window, current, *self._looks[0][1:], stamp_ns - _LAG_NS, delays_ns)
            found = _judged(seen, known)
        self._looks.append((stamp_ns, window.key[current], labels[current]))
        lasting = {one: self._found[one] - 1 for one in known}
        again = {one: self._found.get(one, 0) + 1 for one in found}
        self._found = lasting | {
            one: looks if looks < _LOOKS else _LOOKS + _MORE_LOOKS - 1 for one, looks in again.items()
        }


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
    known = at >= 0
    slots, label = current[known], labels[order][at[known]]
    slots, label = slots[label != NO_HYPOTHESIS], label[label != NO_HYPOTHESIS]
    # What one source sees of one body; the first of these features.
    views = label * (window.source.max(initial=0) + 1) + window.source[slots]
    few = ranks(views, window.key[slots]) < _MAX_FEATURES
    slots, label = slots[few], label[few]
    before_ns = stamp_ns - _SPAN_NS
    stamps = np.array([before_ns, before_ns + _STEP_NS, stamp_ns - _STEP_NS, stamp_ns])
    source, step_s = window.source[slots], _STEP_NS * 1e-9
    x, held = np.zeros((len(stamps), len(slots), window.dim)), np.zeros(len(slots), np.bool_)
    for one in np.unique(source).tolist():
        mine = source == one
        states = states_at(window, slots[mine], stamps - delays_ns.get(one, 0), _DENSE_NS)
        x[:, mine], held[mine] = states.position, states.held.all(0)
    speeds = (x[1] - x[0]) / step_s, (x[3] - x[2]) / step_s
    return _Seen(x[0], x[3], *speeds, source, label).where(held)


def _judged(seen: _Seen, known: Collection[int]) -> set[int]:
    """Sessions that drift, of which some are `known` to; who cannot be judged is as it was.

    Of those apart from all others the clearest one drifts; then the rest is compared without it. Of two
    nobody knows; that which sees the calmest body move less is believed.
    """
    drifting = set(known)
    while True:
        rest = seen.by(drifting, others=True)
        names = np.unique(rest.source).tolist()
        gains = {one: _gain(_motions(rest.by([one], others=True)), rest.by([one])) for one in names}
        apart = {one: gain for one, gain in gains.items() if gain >= 1}
        if not apart:
            break
        if len(gains) == 2:
            apart = {one: _calmest(rest.by([one])) for one in gains}
        drifting.add(max(apart, key=lambda one: apart[one]))
    motions = _motions(rest)
    steady = {one for one in known if _gain(motions, seen.by([one])) < 1}
    return drifting - steady


def _motions(seen: _Seen) -> dict[int, _Motion]:
    """Of each hypothesis that enough features tell, the rigid motion that fits best (Kabsch)."""
    dim = seen.before.shape[1]
    names, row, counts = np.unique(seen.label, return_inverse=True, return_counts=True)
    share = (row == np.arange(len(names))[:, None]) / counts[:, None]
    middle, now = share @ seen.before, share @ seen.after
    before, after = seen.before - middle[row], seen.after - now[row]
    U, _, V = np.linalg.svd((share[:, None] * before.T) @ after)
    V[:, -1] *= np.sign(np.linalg.det(U @ V))[:, None]
    R = (U @ V).transpose(0, 2, 1)
    t = now - np.einsum("kij,kj->ki", R, middle)
    squares = ((np.einsum("nij,nj->ni", R[row], before) - after) ** 2).sum(1)
    squared = np.bincount(row, squares, len(names)).tolist()
    return {
        label: _Motion(R[k], t[k], squared[k], count * dim - dim * (dim + 1) // 2, count)
        for k, (label, count) in enumerate(zip(names.tolist(), counts.tolist(), strict=True))
        if count > dim
    }


def _gain(motions: dict[int, _Motion], other: _Seen) -> float:
    """What a change of a source's offset explains by the motions that others see: 1 is clear.

    NaN where they share too little, or where no change explains the difference.
    """
    shared = [one for one in motions if np.count_nonzero(other.label == one) >= _MIN_FEATURES]
    if shared:
        shared = _agreed({one: motions[one] for one in shared}, other.before)
    if len(shared) < _MIN_BODIES:
        return np.nan
    other = other.where(np.isin(other.label, shared))
    centre = other.before.mean(0)
    extent = float(np.sqrt(((other.before - centre) ** 2).sum(1).mean()))
    apart = np.empty_like(other.after)
    was = _offsets(other.before, other.speed_before, centre)
    change = _offsets(other.after, other.speed_after, centre)
    lasting = change.copy()
    for one in shared:
        rows, motion = other.label == one, motions[one]
        apart[rows] = other.after[rows] - other.before[rows] @ motion.R.T - motion.t
        lasting[rows] -= np.einsum("cd,ndp->ncp", motion.R, was[rows])
    # That of the worse side: thousands of exact features do not make the others exact.
    sides = [motions[one] for one in shared], list(_motions(other).values())
    squares = [sum(one.squared for one in side) / max(sum(one.freedom for one in side), 1) for side in sides]
    noise = float(np.sqrt(max(squares))) + 1e-9 * extent
    dim = len(centre)
    prior = np.repeat([_ROTATION, _SHIFT * extent, _DELAY], [2 * dim - 3, dim, 1]) / noise
    e, J0, J1 = apart.ravel() / noise, lasting.reshape(apart.size, -1), change.reshape(apart.size, -1)
    constant = _left(e, J0 * prior)
    changing = _left(e, np.hstack([J0 * prior, J1 * prior * _CHANGE]))
    # The fewer features tell the motions, the more their errors look like a change.
    clear = _CLEAR * len(prior) * (1 + 2 * len(other.label) / sum(motions[one].features for one in shared))
    return (constant - changing) / clear if changing < _LEFT * len(e) else np.nan


def _agreed(motions: dict[int, _Motion], places: Floats) -> list[int]:
    """Bodies that others see move as one, in a scene of places [n, dim].

    Where they disagree one of them may be right: what they see together is no measure for another.
    """
    noise = {one: motion.squared / max(motion.freedom, 1) for one, motion in motions.items()}
    most = max(_AGREE * min(noise.values(), default=0.0), _EXACT * float(places.var(0).sum()))
    return [one for one in noise if noise[one] <= most]


def _offsets(places: Floats, speeds: Floats, centre: Floats) -> Floats:
    """Derivatives of places [n, dim] by turn, shift and delay, float64 [n, dim, p]."""
    dim = len(centre)
    arm = np.pad(places - centre, ((0, 0), (0, 3 - dim)))
    turn = np.stack([np.cross(axis, arm)[:, :dim] for axis in np.eye(3)[6 - 2 * dim :]], 2)
    shift = np.broadcast_to(np.eye(dim), (len(arm), dim, dim))
    return np.concatenate([turn, shift, speeds[:, :, None]], 2)


def _left(e: Floats, J: Floats) -> float:
    """Least |e - J x|^2 + |x|^2."""
    x = np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ e)
    return float(e @ (e - J @ x))


def _calmest(seen: _Seen) -> float:
    """Mean squared displacement of the body that moves least, as one source sees it."""
    squared = ((seen.after - seen.before) ** 2).sum(1)
    bodies = (squared[seen.label == one] for one in np.unique(seen.label))
    return min((float(one.mean()) for one in bodies if len(one) >= _MIN_FEATURES), default=np.inf)
