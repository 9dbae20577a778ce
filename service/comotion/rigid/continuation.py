"""Carries the last result over to the newest frames without a new fit, as long as it explains them.

This bounds the work of an update by the number of new observations. Known bodies get poses in the new
frames, and the residuals of their members there are tested. New trajectories join a body by their position
and their short motion; those that were too young at the fit may change their body. If other members
are not explained, or many trajectories are new, all bodies are fitted anew.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Ints, Stamps, find
from ..geometry.body import followed_body, stacked
from ..geometry.frames import RENEWED, SETTLED, Frames
from ..geometry.residuals import recent_residuals
from ..geometry.rest import FALSE_ALARMS
from ..trajectories.window import Window
from .assignment import OUTLIER, SearchResult, joined, without_sliders
from .resampling import extended
from .tracks import Tracks

FIRST_HELD, MOST_HELD = 0.04, 0.12
"""Shares of the window: a fit with a new body is held for the first, each later one for twice as long, but at
most for the second, after which bodies are searched anew."""
# Added before the number of new frames is rounded, so that they are about as dense as the others or denser.
_ROUND_UP = 0.45


@dataclass(frozen=True)
class Fit:
    """The result of a fit, and for how long it may be carried over.

    It was fitted at `fitted_ns`, when `judged` trajectories were old enough (:func:`judged`), and is held for
    the share `holds` of the window at most.
    """

    tracks: Tracks
    frames: Frames
    result: SearchResult
    fitted_ns: int
    judged: int
    holds: float


def held(last: Fit, window: Window, now: Tracks, stamp_ns: int, outlying: Stamps) -> Fit | None:
    """The last result at the watermark, or None where all is to be fitted anew.

    Parameters
    ----------
    now
        The trajectories, without corrections of their sources.
    outlying
        int64 [n], ascending, keys of trajectories that are known to be unexplained.
    """
    frames = last.frames
    longest_ns = last.holds * (frames.stamps[-1] - frames.stamps[0])
    same_sources = set(now.source.tolist()) <= set(last.tracks.source.tolist())
    if not (same_sources and frames.stamps[-1] < stamp_ns < last.fitted_ns + longest_ns):
        return None
    tracks = last.tracks.joined(now)
    fresh = len(tracks.key) - len(frames.key)
    # Frames are in the order of keys. A key below their last one is no new trajectory: in a large space,
    # other trajectories are grouped now than at the fit.
    if fresh and (tracks.key[-fresh] < frames.key[-1] or _lost(last.result.assignment.labels, tracks)):
        return None
    stamps = _stamps(frames, stamp_ns)
    recent = tracks.since(window, int(stamps[0] - np.abs(tracks.delay_ns).max(initial=0)))
    longer = extended(frames, recent, stamps, window.gap_ns)
    if judged(longer) - last.judged > RENEWED * int(longer.current.sum()):
        return None
    bodies = [followed_body(longer, body) for body in last.result.bodies]
    result = replace(last.result, bodies=bodies)
    unexplained = _unexplained(longer, result, len(frames.stamps)) & (find(longer.key, outlying) < 0)
    # Only a trajectory that was too young at the fit may leave its body without a new fit.
    if (unexplained & (longer.life - (stamp_ns - last.fitted_ns) * 1e-9 >= frames.config.min_life)).any():
        return None
    leaving = np.flatnonzero(unexplained[: len(frames.key)])
    if fresh or len(leaving):
        result = joined(longer, tracks.newest, result, leaving)
    return replace(last, tracks=tracks, frames=longer, result=result)


def judged(frames: Frames) -> int:
    """Number of trajectories that were observed for long enough to be searched for hypotheses."""
    return int(np.count_nonzero(frames.life >= frames.config.min_life))


def _lost(labels: Ints, tracks: Tracks) -> bool:
    """Whether none of the trajectories of a body, by labels intp [N], go on: it may return."""
    known = np.bincount(labels - OUTLIER)
    going_on = np.bincount(labels[tracks.current[: len(labels)]] - OUTLIER, minlength=len(known))
    return bool((going_on[1:] < np.minimum(known[1:], 1)).any())


def _stamps(frames: Frames, stamp_ns: int) -> Stamps:
    """Frames after the last one, up to the watermark."""
    last_ns = int(frames.stamps[-1])
    count = max(round((stamp_ns - last_ns) * 1e-9 * frames.config.frame_rate + _ROUND_UP), 1)
    return last_ns + (stamp_ns - last_ns) * np.arange(1, count + 1, dtype=np.int64) // count


def _unexplained(frames: Frames, result: SearchResult, first: int) -> Bools:
    """Which trajectories leave their body in the frames from `first` on, bool [N].

    The squared residuals of one that does not are chi-squared; the bound of their tail is that of Laurent and
    Massart (2000), for a false alarm among all trajectories in so many updates.
    """
    labels = without_sliders(result.assignment.labels, result.evidence)
    all_labels = np.append(labels, np.full(len(frames.key) - len(labels), OUTLIER))
    body = np.where(frames.current, all_labels, OUTLIER)[frames.owner]
    squared, count = np.zeros(len(body)), np.zeros(len(body))
    span = max(first - round(SETTLED * frames.config.frame_rate), 0), first, len(frames.stamps)
    # With the memory behind them, the arrays are contiguous.
    y, w = frames.room or (frames.y, frames.w)
    arrays, poses = frames.arrays._replace(y=y, w=w), stacked(result.bodies)
    recent_residuals(arrays, body, poses, result.evidence.soft, span, squared, count)
    freedom = frames.dim * np.bincount(frames.owner, count, len(frames.key))
    rare = float(np.log(FALSE_ALARMS * max(int(frames.current.sum()), 1)))
    most = freedom + 2 * np.sqrt(freedom * rare) + 2 * rare
    return np.asarray(np.bincount(frames.owner, squared, len(frames.key)) > most, np.bool_)
