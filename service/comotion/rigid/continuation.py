"""In the last result and what was observed since, out the same result now, where it explains that as well.

An update costs what is new. Known bodies get their poses in the new frames; what their members do there is
compared with where they were in their body. Trajectories that are new join a body by place and by the little
that they have moved, and again where they leave it if they were too young for the fit. Where something else
is not explained, or much is new, all is fitted anew.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Ints, Stamps, find, identities
from ..config import RigidConfig
from ..matching import continued, largest_total
from ..trajectories.window import Window
from .assignment import OUTLIER, SearchResult, joined, without_sliders
from .costs import stacked
from .frames import Frames
from .kernels.procrustes import continue_poses
from .kernels.records import PoseArrays
from .kernels.residuals import recent_residuals
from .procrustes import Body, static_body
from .resampling import extended
from .tracks import Tracks

# A result holds for this share of the window; twice as long as the one before that it confirms, but at most
# for so large a share.
_HELD_SHARE, _MOST_HELD = 0.04, 0.12
# A fit confirms another where at most so large a share of the trajectories changes its body.
_CHANGED_SHARE = 0.02
# It holds until so large a share of the trajectories is new.
_NEW_SHARE = 0.05
# s before the new frames in which the place of a trajectory in its body is taken.
_REFERENCE_TIME = 1.0
# New frames are at least as dense as the others, but for so much of a frame.
_ROUND_UP = 0.45
# A trajectory that its body explains looks unexplained in one of so many updates.
_FALSE_ALARMS = 20.0


@dataclass(frozen=True)
class Fit:
    """What an update has found.

    At `fitted_ns` all of it was fitted, and so many were :func:`judged`; it may be held for the share `holds`
    of the window.
    """

    tracks: Tracks
    frames: Frames
    result: SearchResult
    fitted_ns: int
    judged: int
    holds: float = _HELD_SHARE


def held(
    last: Fit, window: Window, now: Tracks, stamp_ns: int, odd: Stamps, config: RigidConfig
) -> Fit | None:
    """The last result at the watermark, or None where all is to be fitted anew.

    Parameters
    ----------
    now
        The trajectories, without corrections of their sources.
    odd
        int64 [n], ascending, keys of trajectories that are known to be unexplained.
    """
    frames = last.frames
    kept_ns = last.holds * (frames.stamps[-1] - frames.stamps[0])
    if not frames.stamps[-1] < stamp_ns < last.fitted_ns + kept_ns:
        return None
    tracks = last.tracks.joined(now)
    fresh = len(tracks.key) - len(frames.key)
    # Trajectories stand by their keys. Where others of a large space are grouped than before, none is new.
    if fresh and (tracks.key[-fresh] < frames.key[-1] or _lost(last.result.assignment.labels, tracks)):
        return None
    stamps = _stamps(int(frames.stamps[-1]), stamp_ns, config)
    recent = tracks.since(window, int(stamps[0] - np.abs(tracks.delay_ns).max(initial=0)))
    more = extended(frames, recent, stamps, window.gap_ns, config)
    if more is None or judged(more, config) - last.judged > _NEW_SHARE * int(more.current.sum()):
        return None
    bodies = [_followed(more, body) for body in last.result.bodies]
    result = replace(last.result, bodies=bodies)
    unexplained = _unexplained(more, result, len(frames.stamps), config) & ~np.isin(more.key, odd)
    # What was too young for the fit joins another body than the one that it leaves.
    if (unexplained & (more.life - (stamp_ns - last.fitted_ns) * 1e-9 >= config.min_life)).any():
        return None
    again = np.flatnonzero(unexplained[: len(frames.key)])
    if fresh or len(again):
        result = joined(more, tracks.newest, result, again, config)
    return replace(last, tracks=tracks, frames=more, result=result)


def judged(frames: Frames, config: RigidConfig) -> int:
    """How many trajectories were observed for so long that they take part in finding hypotheses."""
    return int(np.count_nonzero(frames.life >= config.min_life))


def holding(last: Fit | None, frames: Frames, labels: Ints) -> float:
    """For what share of the window a new fit may be held, by its labels intp [N] and the last fit."""
    if last is None:
        return _HELD_SHARE
    at = find(frames.key, last.frames.key)
    then, now = last.result.assignment.labels[at[at >= 0]], labels[at >= 0]
    count = now.max(initial=-1) + 1
    heirs = continued(then, now, count, largest_total)
    same = then == np.append([heirs.get(k, OUTLIER) for k in range(count)], OUTLIER)[now]
    confirmed = np.count_nonzero(~same) <= _CHANGED_SHARE * len(same)
    return min(2 * last.holds, _MOST_HELD) if confirmed else _HELD_SHARE


def _lost(labels: Ints, tracks: Tracks) -> bool:
    """Whether none of the trajectories of a body, by labels intp [N], go on: it may return."""
    return bool(len(np.setdiff1d(labels, np.append(labels[tracks.current[: len(labels)]], OUTLIER))))


def _stamps(last_ns: int, stamp_ns: int, config: RigidConfig) -> Stamps:
    """Frames after the last one, up to the watermark."""
    count = max(round((stamp_ns - last_ns) * 1e-9 * config.frame_rate + _ROUND_UP), 1)
    return last_ns + (stamp_ns - last_ns) * np.arange(1, count + 1, dtype=np.int64) // count


def _followed(frames: Frames, body: Body) -> Body:
    """The body with poses in the frames that it has none for."""
    first, count = len(body.t), len(frames.stamps)
    if body.static:
        return static_body(count)
    R, t, posed = identities(count), np.zeros((count, 3)), np.zeros(count, np.bool_)
    R[:first], t[:first], posed[:first] = body.R, body.t, body.posed
    y = np.ascontiguousarray(frames.y[body.rows, first:].transpose(1, 2, 0))
    w = np.ascontiguousarray(frames.w[body.rows, first:].T)
    noise = 1 / frames.tolerance[body.rows], frames.metric[body.rows]
    template = np.ascontiguousarray(body.template.T)
    continue_poses(y, w, *noise, frames.dim, first, template, PoseArrays(R, t, posed))
    return replace(body, R=R, t=t, posed=posed)


def _unexplained(frames: Frames, result: SearchResult, first: int, config: RigidConfig) -> Bools:
    """Which trajectories leave their body in the frames from `first` on, bool [N].

    The squared residuals of one that does not are chi-squared; the bound of their tail is that of Laurent and
    Massart (2000).
    """
    labels = without_sliders(result.assignment.labels, result.evidence)
    known = np.append(labels, np.full(len(frames.key) - len(labels), OUTLIER))
    body = np.where(frames.current, known, OUTLIER)[frames.owner]
    squared, count = np.zeros(len(body)), np.zeros(len(body))
    span = max(first - round(_REFERENCE_TIME * config.frame_rate), 0), first
    poses, soft = stacked(result.bodies), result.evidence.soft
    recent_residuals(frames.arrays, body, poses, soft, span, squared, count)
    freedom = frames.dim * np.bincount(frames.owner, count, len(frames.key))
    rare = float(np.log(_FALSE_ALARMS * max(int(frames.current.sum()), 1)))
    most = freedom + 2 * np.sqrt(freedom * rare) + 2 * rare
    return np.asarray(np.bincount(frames.owner, squared, len(frames.key)) > most, np.bool_)
