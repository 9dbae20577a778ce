"""The kernels of the rigid method in plain NumPy: what the compiled code must give."""

import numpy as np

from .interpolation import segment

PULL = 1e-3
SOFT = 9.0


def best_rotation(H):
    """R that maximises tr(R^T H) over rotations [3, 3] (Kabsch)."""
    u, _, vt = np.linalg.svd(H)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt


def weighted_pose(y, b, weights, near):
    """(R, t) of the least-squares pose y = R b + t of points [m, 3], with a pull towards a rotation."""
    p, q = np.average(y, axis=0, weights=weights), np.average(b, axis=0, weights=weights)
    H = (weights[:, None] * (y - p)).T @ (b - q)
    H += PULL * np.linalg.norm(H) * near
    R = best_rotation(H)
    return R, p - R @ q


def fit_poses(y, w, tolerance, iterations):
    """(template [m, 3], R [F, 3, 3], t [F, 3], posed [F]) of rows [m, F, 3] in 3-D: Gower (1975)."""
    m, count = w.shape
    full = max(range(count), key=lambda f: ((w[:, f] > 0).sum(), f))
    known = w[:, full] > 0
    b = np.where(known[:, None], y[:, full], 0.0)
    R, t, posed = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros(count, bool)
    for iteration in range(iterations):
        totals, sums, near = np.zeros(m), np.zeros((m, 3)), np.eye(3)
        for f in reversed(range(count)):
            a = w[:, f] / tolerance
            squared = ((y[:, f] - b @ R[f].T - t[f]) ** 2).sum(1)
            weight = a * known
            if iteration > 0 and posed[f]:
                weight = weight / (1 + weight * squared / (SOFT * 3))
            posed[f] = (weight > 0).sum() >= (2 if m <= 2 else 3)
            if not posed[f]:
                continue
            R[f], t[f] = weighted_pose(y[:, f], b, weight, near)
            near = R[f]
            x = (y[:, f] - t[f]) @ R[f]
            a = a / (1 + a * known * ((x - b) ** 2).sum(1) / (SOFT * 3))
            totals, sums = totals + a, sums + a[:, None] * x
        seen = totals > 0
        b[seen], known = sums[seen] / totals[seen, None], known | seen
    return b, R, t, posed


def settled(w, noise, b, dof, poses):
    """(R, t, rests) of a body [m, 3] with one pose for each rest, newest first; w [m, F], noise [m]."""
    R, t, posed = (part.copy() for part in poses)
    rests, stop = np.zeros(len(t), bool), len(t)
    while stop > 0:
        run = []
        for f in reversed(range(stop)):
            if not posed[f]:
                continue
            trial = [f, *run]
            a = w[:, trial] / noise[:, None]
            places = np.einsum("fij,mj->mfi", R[trial], b) + t[trial]
            seen = a.sum(1) > 0
            mean = np.einsum("mf,mfi->mi", a[seen], places[seen]) / a[seen].sum(1)[:, None]
            scatter = (a[seen] * ((places[seen] - mean[:, None]) ** 2).sum(2)).sum()
            expected = dof / 2 * len(run)
            if scatter / 2 > expected + 2 * np.sqrt(expected) + 6:
                break
            run = trial
        if len(run) >= 8:
            a = (w[:, run] / noise[:, None]).sum(1)
            places = np.einsum("mf,fij,mj->mi", w[:, run] / noise[:, None], R[run], b)
            places += (w[:, run] / noise[:, None]) @ t[run]
            seen = a > 0
            R[run], t[run] = weighted_pose(places[seen] / a[seen, None], b[seen], a[seen], R[run[0]])
            rests[run] = True
        stop = min(run[0] if run else stop, stop - 1)
    return R, t, rests


def smooth(z, weight, moving, channels, share):
    """(path, nats beyond lines) of z [F, C] under the most likely of seven strengths of acceleration."""
    fits = []
    for stiffness in (1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6, 1e8):
        path, nats, cost, pull = z.copy(), 0.0, 0.0, stiffness * weight[moving].mean()
        for run in runs_of(moving):
            if len(run) < 4:
                continue
            W, D = np.diag(weight[run]), np.diff(np.eye(len(run)), 2, axis=0)
            A, seen = W + pull * D.T @ D, z[run] - z[run].mean(0)
            line = np.column_stack([np.ones(len(run)), np.arange(len(run))])
            path[run] += np.linalg.solve(A, W @ seen) - seen
            freedom = np.linalg.slogdet(A)[1] - (len(run) - 2) * np.log(pull)
            cost += channels * freedom + share * (seen * (W @ (z[run] - path[run]))).sum()
            nats += 0.5 * channels * (freedom - np.linalg.slogdet(line.T @ W @ line)[1])
            nats += 0.5 * share * pull * ((D @ path[run]) ** 2).sum()
        fits.append((cost, path, nats))
    return min(fits, key=lambda fit: fit[0])[1:]


def runs_of(moving):
    """Frames of each run of moving ones."""
    runs = np.split(np.arange(len(moving)), np.flatnonzero(np.diff(moving)) + 1)
    return [run for run in runs if moving[run[0]]]


def smooth_poses(middle, place, turn, moving, dim, poses):
    """(R, t, number of free poses, nats beyond lines) of a body on smooth paths."""
    R, t, _ = poses
    angles = 3 if dim == 3 else 1
    centres, nats = smooth(R @ middle + t, place, moving, dim, 1.0)
    turns, turned = smooth(R.reshape(-1, 9), turn, moving, angles, 0.5)
    R = np.where(moving[:, None, None], [best_rotation(one.reshape(3, 3)) for one in turns], R)
    t = np.where(moving[:, None], centres - R @ middle, t)
    return R, t, sum(2 if len(run) >= 4 else len(run) for run in runs_of(moving)), nats + turned


def row_cost(y, w, v, poses, soft, cap, unposed, spectrum=(1.0, 0.0, 0.0), metric=(1.0, 0, 0, 1.0, 0, 1.0)):
    """(cost, mean squared residual) of one row [F, 3] under a body (R, t, posed), 3-D.

    `soft` is the variance of its deformation and the correlation of that from frame to frame.
    """
    R, t, posed = poses
    M = np.zeros((3, 3))
    M[np.triu_indices(3)] = metric
    M += np.triu(M, 1).T
    seen, used = w > 0, (w > 0) & posed
    charge = 3 if used.sum() >= 0.6 * seen.sum() else unposed
    missing = 0.5 * charge * (seen & ~posed).sum()
    if not used.any():
        return missing, 0.0
    x, a = np.einsum("fji,fj->fi", R[used], y[used] - t[used]), w[used]
    turned = np.einsum("fji,jk,fkl->fil", R[used], M, R[used])
    mean = np.average(x, axis=0, weights=a)
    squared = np.einsum("fi,fij,fj->f", x - mean, turned, x - mean)
    b = np.average(x, axis=0, weights=a / (1 + a * squared / (SOFT * 3 * v)))
    own, more = spectrum[1], soft[0] / v
    memory = (own * spectrum[2] + more * soft[1]) / max(own + more, 1e-300)
    mixed = spectrum[0], own + more, memory
    squared = squared_innovations(np.flatnonzero(used), x - b, w, v, mixed, turned)
    wider = np.log(innovation_variances(w, mixed) / innovation_variances(w, spectrum))[used]
    return missing + 0.5 * (np.minimum(squared / v, cap * 3) + 3 * wider).sum(), squared.mean()


def innovation_variances(w, spectrum):
    """Variances of the innovations [F], times the weights; NaN where nothing is observed."""
    white, slow, memory = spectrum
    variance, found = slow, np.full(len(w), np.nan)
    for f in range(len(w)):
        gain = 0.0
        if w[f] > 0:
            found[f] = w[f] * variance + white
            gain = w[f] * variance / found[f]
        variance = memory**2 * (1 - gain) * variance + (1 - memory**2) * slow
    return found


def squared_innovations(at, x, w, v, spectrum, metrics):
    """Squared innovations [n], in v / v, of points [n, 3] at frames [n] of a row with weights w [F].

    The gain is that of all observed frames; an outlier moves the state less.
    """
    white, slow, memory = spectrum
    state, variance, found = np.zeros(3), slow, []
    for f in range(len(w)):
        gain, precision = 0.0, 0.0
        if w[f] > 0:
            gain = variance / (variance + white / w[f])
            precision = 1 / (variance + white / w[f])
        if f in at:
            error = x[list(at).index(f)] - state
            found.append(precision * (error @ metrics[list(at).index(f)] @ error))
            state = state + gain / (1 + found[-1] / (SOFT * 3 * v)) * error
        state = memory * state
        variance = memory**2 * (1 - gain) * variance + (1 - memory**2) * slow
    return np.array(found)


def normal_equations(y, w, seconds, v, poses, information, pivot):
    """(left [7, 7], right [7], squared residual) of rows that should be constant in a body's frame.

    The errors of the poses, six for each frame, are unknowns with an information of their own.
    """
    R, t, posed = poses
    count = len(seconds)
    left, right, squared = np.zeros((7 + 6 * count,) * 2), np.zeros(7 + 6 * count), 0.0
    for f in range(count):
        own = slice(7 + 6 * f, 13 + 6 * f)
        left[own, own] = information[f]
    for i in range(len(y)):
        used = np.flatnonzero((w[i] > 0) & posed)
        velocity = np.gradient(y[i, used], seconds[used], axis=0)
        design, z = np.zeros((len(used), 3, 7)), np.einsum("fji,fj->fi", R[used], y[i, used] - t[used])
        for k, f in enumerate(used):
            turned = [np.cross(axis, y[i, f] - pivot) for axis in np.eye(3)]
            design[k] = R[f].T @ np.column_stack([*turned, np.eye(3), velocity[k]])
        whole = np.zeros((len(used), 3, 7 + 6 * count))
        whole[:, :, :7] = design - design.mean(0)
        for k, f in enumerate(used):
            turned = [np.cross(axis, z.mean(0)) for axis in np.eye(3)]
            whole[k, :, 7 + 6 * f : 13 + 6 * f] = np.column_stack([*turned, np.eye(3)])
        J, r = whole.reshape(-1, 7 + 6 * count), (z - z.mean(0)).ravel()
        left, right, squared = left + J.T @ J / v[i], right - J.T @ r / v[i], squared + r @ r / v[i]
    inverse = np.linalg.pinv(left[7:, 7:])
    across = left[:7, 7:] @ inverse
    return (
        left[:7, :7] - across @ left[7:, :7],
        right[:7] - across @ right[7:],
        squared - right[7:] @ inverse @ right[7:],
    )


def gross_errors(times, positions, variance):
    """Which observations leave their trajectory and come back, bool [n]."""
    found, n = np.zeros(len(times), bool), len(times)
    bend = np.zeros_like(positions)
    for k in range(1, n - 1):
        line = [np.interp(times[k], times[[k - 1, k + 1]], x[[k - 1, k + 1]]) for x in positions.T]
        bend[k] = positions[k] - line
    for k in range(1, n - 1 if n >= 5 else 0):
        near = positions[max(k - 3, 0) : k + 4]
        middle = np.median(near, axis=0)
        spread = (1.4826 * np.median(np.abs(near - middle), axis=0)) ** 2
        turns_back = bend[k] @ bend[k - 1] < 0 or bend[k] @ bend[k + 1] < 0
        far = ((positions[k] - middle) ** 2).sum() > 36 * np.maximum(spread, variance).sum()
        found[k] = turns_back and bend[k] @ bend[k] > 36 * variance and far
    return found


def resample(times, positions, stamps, gap, hold, delay, variance):
    """(y [F, dim], w [F]) of one trajectory at common frames, without its gross errors."""
    good = ~gross_errors(times, positions, variance)
    clean = times[good], positions[good]
    whole = interpolated(times, positions, stamps, gap, hold, delay)
    part = interpolated(*clean, stamps, gap, hold, delay)
    # What is in a gap stays so, though an error may be the end of it.
    return tuple(np.where((whole[1] > 0).reshape(-1, *[1] * (x.ndim - 1)), x, 0) for x in part)


def interpolated(times, positions, stamps, gap, hold, delay):
    """(y [F, dim], w [F]) of one trajectory at common frames."""
    y, w = np.zeros((len(stamps), positions.shape[1])), np.zeros(len(stamps))
    for f, stamp in enumerate(stamps):
        left, right, a = segment(times.tolist(), stamp - delay, gap, hold)
        if left >= 0:
            y[f] = (1 - a) * positions[left] + a * positions[right]
            w[f] = 1 / ((1 - a) ** 2 + a**2)
    return y, w


def third_differences(times, positions, gap):
    """The normalised third divided differences of one trajectory, without gaps, [k, dim]."""
    found = []
    for m in range(len(times) - 3):
        t = (times[m : m + 4] - times[m]) * 1e-7
        steps = np.diff(times[m : m + 4])
        if (steps <= gap).all():
            c = np.array([1 / np.prod([t[j] - t[k] for k in range(4) if k != j]) for j in range(4)])
            found.append((c / np.linalg.norm(c)) @ positions[m : m + 4])
    return np.array(found).reshape(-1, positions.shape[1])


def distance_deviation(y, w):
    """Standard deviation of the distance of each pair of rows over common frames, [n, n]."""
    n = len(w)
    found = np.full((n, n), np.nan)
    for i in range(n):
        for j in range(n):
            both = (w[i] > 0) & (w[j] > 0)
            if i != j and both.sum() >= 2:
                found[i, j] = np.linalg.norm(y[i] - y[j], axis=1)[both].std(ddof=1)
    return found


def farthest_points(x, count):
    """Indices of points [n, 3]: the first, then always the farthest from those before."""
    found = [0]
    while len(found) < count:
        squared = ((x[:, None] - x[found]) ** 2).sum(2).min(1)
        found.append(int(squared.argmax()))
    return found
