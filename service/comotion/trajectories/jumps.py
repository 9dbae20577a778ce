"""Finds trajectories that jump, where a tracker continues an id on another feature.

Trackers exchange features now and then, or slip to a neighbour that looks alike. No body moves like a
trajectory across such a jump.
"""

from bisect import bisect_right

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..arrays import Bools, Floats, Ints, Slots, Stamps, median
from .window import Window

# Steps before and after a jump that are compared with it; and the least ratio of its difference from their
# mean velocity to theirs.
_STEPS_BEFORE, _STEPS_AFTER, _MIN_RATIO = 3, 2, 8.0
# Least length of a jump, as a share of the extent of all. Reconstructed markers jump by less, and their
# hypotheses should not be lost: with a fiftieth the recordings of docs/research/accuracy.md lose .004.
_LEAST = 0.1
# Jumps of one source at one instant are alike where they differ by less than this share of their length:
# then a body has moved. So it has, or the whole scene, where more than a share of all features jump at once.
_ALIKE, _MOST = 0.5, 0.25
# ns within which observations confirm a jump, and newest observations of a trajectory that are examined.
_CONFIRMED_NS, _OBSERVATIONS = 500_000_000, 64


def jumps(window: Window, slots: Slots, since_ns: int) -> tuple[Slots, Ints]:
    """Find which slots intp [n] have jumped alone, as observations after `since_ns` confirm.

    Only those with a long step are examined. The length of a long step is set in the window (`far`), for the
    observations to come. Returns those that have, and the first observation after the newest jump of each, an
    index in the columns of the window: intp [m] each.
    """
    if not len(slots):
        return slots, slots
    newest = window.newest(slots)
    window.far = _LEAST * float(np.sqrt(((newest - median(newest)) ** 2).sum(1).mean()))
    recent = since_ns - _CONFIRMED_NS
    candidates = (window.far_ns[slots] > recent) & (window.counts(slots) > _STEPS_BEFORE + _STEPS_AFTER + 1)
    if not candidates.any():
        return slots[:0], slots[:0]
    all_slots, slots = slots, slots[candidates]
    width = min(len(window.instants) - bisect_right(window.instants, recent), _OBSERVATIONS) + _STEPS_BEFORE
    columns = window.stop[slots, None] + np.arange(-width - _STEPS_AFTER - 1, 0)
    held, columns = columns >= window.start[slots, None], np.maximum(columns, 0)
    positions = window.positions[slots[:, None], columns]
    times = window.times[slots[:, None], columns]
    sudden = _sudden(times, positions, held)
    row, step = np.nonzero(sudden & (times[:, _STEPS_BEFORE + _STEPS_AFTER + 1 :] > since_ns))
    last = np.append(row[1:] != row[:-1], True)[: len(row)]
    jumping, first = slots[row[last]], columns[row[last], step[last] + _STEPS_BEFORE + 1]
    return _alone(window, all_slots, jumping, first)


def _sudden(times: Stamps, positions: Floats, held: Bools) -> Bools:
    """Which steps are jumps, bool [n, M - 6], from the fourth step of M observations on.

    Times [n, M] and positions [n, M, dim] are observations of the trajectory where they are `held`.
    """
    velocity = np.diff(positions, axis=1) / np.maximum(np.diff(times), 1)[:, :, None]
    velocity[~held[:, :-1]] = np.nan
    steps = sliding_window_view(velocity, _STEPS_BEFORE + 1 + _STEPS_AFTER, 1)
    usual = np.delete(steps, _STEPS_BEFORE, 3).mean(3)
    off = np.linalg.norm(steps - usual[..., None], axis=2)
    return np.asarray(off[:, :, _STEPS_BEFORE] > _MIN_RATIO * np.delete(off, _STEPS_BEFORE, 2).max(2))


def _alone(window: Window, slots: Slots, jumping: Slots, first: Ints) -> tuple[Slots, Ints]:
    """Those of `jumping` that jump far and unlike others at that time, and the `first` of each.

    `slots` intp [n] are all trajectories.
    """
    step = window.positions[jumping, first] - window.positions[jumping, first - 1]
    length, stamp, source = np.linalg.norm(step, axis=1), window.times[jumping, first], window.source[jumping]
    together = (stamp[:, None] == stamp) & (source[:, None] == source)
    difference = np.linalg.norm(step[:, None] - step, axis=2)
    alike = together & (difference < _ALIKE * np.minimum(length[:, None], length))
    most = np.maximum(_MOST * np.bincount(window.source[slots])[source], 2) if len(source) else length
    alone = (length > window.far) & (alike.sum(1) <= 1) & (together.sum(1) <= most)
    return jumping[alone], first[alone]
