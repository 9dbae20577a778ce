"""Positions on key frames in; distances between trajectories, and what the nearest ones say, out."""

import numpy as np

from ...arrays import Bools, Floats, Floats32, Ints, Labels
from ...compiled import compiled
from ...partition import NO_HYPOTHESIS

# px; added to a distance before it is inverted: a neighbour next to nothing must not outweigh all others.
_NEAR_PX = 1.0
# Added to a mean similarity before its logarithm is taken, so that 0 stays finite.
_SIMILARITY_FLOOR = 1e-3


@compiled()
def smallest(values: Floats32, count: int) -> Ints:
    """Indices of the smallest values, in order; the first of equals first."""
    best = np.zeros(min(count, len(values)), np.intp)
    held = 0
    for j in range(len(values)):
        if held == len(best) and values[j] >= values[best[held - 1]]:
            continue
        k = held if held < len(best) else held - 1
        while k > 0 and values[j] < values[best[k - 1]]:
            best[k] = best[k - 1]
            k -= 1
        best[k] = j
        held = min(held + 1, len(best))
    return best


@compiled()
def centred_terms(values: Floats32, seen: Floats32) -> Floats32:
    """x, y, whether seen and x² + y² of values [F, N, 2] about their frame's mean, [4, F, N]; else 0."""
    terms = np.empty((4, *seen.shape), np.float32)
    for f in range(len(values)):
        cx = cy = count = 0.0
        for j in range(values.shape[1]):
            cx += values[f, j, 0] * seen[f, j]
            cy += values[f, j, 1] * seen[f, j]
            count += seen[f, j]
        # Shifting by the frame's mean keeps the difference of large squares accurate in float32.
        mx, my = np.float32(cx / max(count, 1.0)), np.float32(cy / max(count, 1.0))
        for j in range(values.shape[1]):
            x, y = (values[f, j, 0] - mx) * seen[f, j], (values[f, j, 1] - my) * seen[f, j]
            terms[0, f, j], terms[1, f, j], terms[2, f, j], terms[3, f, j] = x, y, seen[f, j], x * x + y * y
    return terms


@compiled()
def combine_distances(
    place: Floats32,
    both: Floats32,
    motion: Floats32,
    moving: Floats32,
    weight: np.float32,
    frames: np.float32,
) -> None:
    """Distances in place of the sums of squared differences in the image `place`, all [H, N].

    `both` counts the common frames of `place`, `moving` those of `motion`, the sums for displacements.
    """
    one, zero = np.float32(1), np.float32(0)
    for h in range(place.shape[0]):
        for j in range(place.shape[1]):
            apart = np.sqrt(max(place[h, j], zero) / max(both[h, j], one))
            apart += weight * np.sqrt(max(motion[h, j], zero) / max(moving[h, j], one))
            apart /= np.sqrt(max(both[h, j], one) / frames)
            place[h, j] = apart if both[h, j] >= 2 else np.float32(np.inf)


@compiled()
def within_limits(distance: Floats32, limits: Floats32, count: int) -> Ints:
    """Indices of the `count` columns up to a row's limit, ascending, [H, count]; of ties the first ones."""
    near = np.empty((len(distance), count), np.intp)
    for h in range(len(distance)):
        limit, ties, found = limits[h], count, 0
        for j in range(distance.shape[1]):
            ties -= distance[h, j] < limit
        for j in range(distance.shape[1]):
            if distance[h, j] <= limit and (distance[h, j] < limit or ties > 0):
                ties -= distance[h, j] == limit
                near[h, found] = j
                found += 1
    return near


@compiled()
def pick_members(distance: Floats32, near: Ints, seeds: Ints, lots: Floats, picks: Ints) -> None:
    """Members [H, M] of each seed: itself and those of its nearest that draw the smallest lots [H, R].

    `near` [H, L] holds at least the R nearest of each seed by `distance` [H, N], the seed among them.
    """
    for h in range(len(seeds)):
        # Ascending, so that the picks do not depend on who is a little nearer.
        among = near[h][np.sort(smallest(distance[h][near[h]], lots.shape[1]))]
        lots[h][among == seeds[h]] = -1
        picks[h] = among[smallest(lots[h], picks.shape[1])]


@compiled()
def similarity_to_nearest(
    positions: Floats32, seen: Floats32, similarity: Floats32, picked: Ints, others: Ints, nearest: int
) -> tuple[Floats, Floats]:
    """Log of the mean similarity of the picked to their nearest others, and their mean distance in px.

    Of positions [F, 2, N] and visibility [F, N]; NaN and infinite where no other shares a frame.
    """
    x, y, m = positions[:, 0][:, others], positions[:, 1][:, others], seen[:, others]
    alike = np.full(len(picked), np.nan)
    far = np.full(len(picked), np.inf)
    for p in range(len(picked)):
        i = picked[p]
        distance = _image_distances(positions[:, 0, i], positions[:, 1, i], seen[:, i], x, y, m)
        distance[others == i] = np.inf
        near = smallest(distance, nearest)
        near = near[np.isfinite(distance[near])]
        if len(near):
            total = 0.0
            for j in near:
                total += similarity[i, others[j]]
            alike[p] = np.log(total / len(near) + _SIMILARITY_FLOOR)
            far[p] = distance[near].mean()
    return alike, far


@compiled()
def _image_distances(
    px: Floats32, py: Floats32, own: Floats32, x: Floats32, y: Floats32, m: Floats32
) -> Floats32:
    """Root mean square distance in the image over common frames, [n]; inf without any."""
    square = np.zeros(x.shape[1], np.float32)
    count = np.zeros(x.shape[1], np.float32)
    for f in range(len(own)):
        if own[f] > 0:
            for j in range(x.shape[1]):
                dx, dy = x[f, j] - px[f], y[f, j] - py[f]
                square[j] += (dx * dx + dy * dy) * m[f, j]
                count[j] += m[f, j]
    for j in range(x.shape[1]):
        square[j] = np.sqrt(square[j] / count[j]) if count[j] > 0 else np.float32(np.inf)
    return square


@compiled()
def newborn_distances(
    positions: Floats, valid: Bools, own: Floats, instant: Ints, owner: Ints, count: int, motion_weight: float
) -> Floats:
    """Mean distance in the image plus weighted root mean square distance of displacements, [count, m].

    Observation k of newborn ``owner[k]`` is at ``own[k]`` [2] at ``instant[k]``; the others are at
    positions [T, m, 2] where `valid` [T, m]. Infinite where no instant is shared.
    """
    shape = count, valid.shape[1]
    total, shared, square, moves = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for k in range(len(own)):
        n, t = owner[k], instant[k]
        moved = k > 0 and owner[k - 1] == n
        for j in range(valid.shape[1]):
            if valid[t, j]:
                x, y = positions[t, j, 0] - own[k, 0], positions[t, j, 1] - own[k, 1]
                total[n, j] += np.sqrt(x * x + y * y)
                shared[n, j] += 1
                if moved and valid[instant[k - 1], j]:
                    x -= positions[instant[k - 1], j, 0] - own[k - 1, 0]
                    y -= positions[instant[k - 1], j, 1] - own[k - 1, 1]
                    square[n, j] += x * x + y * y
                    moves[n, j] += 1
    for n in range(count):
        for j in range(valid.shape[1]):
            if shared[n, j] > 0:
                total[n, j] = total[n, j] / shared[n, j]
                total[n, j] += motion_weight * np.sqrt(square[n, j] / max(moves[n, j], 1.0))
            else:
                total[n, j] = np.inf
    return total


@compiled()
def weighted_votes(
    distance: Floats, labels: Labels, previous: Labels, voters: int, previous_votes: float
) -> tuple[Labels, Floats]:
    """Label with most votes of the nearest, the smaller of equals, and its share of votes, [n] each.

    The nearer, the more a vote counts (Dudani 1976): of the nearest some may be far away on another
    body. A previous label counts `previous_votes` average votes more.
    """
    found = np.full(len(distance), NO_HYPOTHESIS)
    share = np.zeros(len(distance))
    for k in range(len(distance)):
        near = smallest(distance[k], voters)
        near = near[np.isfinite(distance[k][near])]
        weight = 1 / (distance[k][near] + _NEAR_PX)
        weight *= len(near) / weight.sum()
        most = 0.0
        for label in np.sort(labels[near]):
            votes = weight[labels[near] == label].sum()
            total = votes + previous_votes * (previous[k] == label)
            if total > most:
                most, found[k], share[k] = total, label, votes / len(near)
    return found, share
