"""The cost of a trajectory under a body in plain NumPy: what the compiled code must give."""

import numpy as np

SOFT = 9.0


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
    for _ in range(2):
        squared = np.einsum("fi,fij,fj->f", x - mean, turned, x - mean)
        mean = np.average(x, axis=0, weights=a / (1 + a * squared / (SOFT * 3 * v)))
    own, more = spectrum[1], soft[0] / v
    memory = (own * spectrum[2] + more * soft[1]) / max(own + more, 1e-300)
    mixed = spectrum[0], own + more, memory
    squared = squared_innovations(np.flatnonzero(used), x - mean, w, v, mixed, turned)
    wider = np.log(filtered(w, mixed)[0] / filtered(w, spectrum)[0])[used]
    return missing + 0.5 * (np.minimum(squared / v, cap * 3) + 3 * wider).sum(), squared.mean()


def filtered(w, spectrum):
    """Variances of the innovations [F], times the weights, NaN where nothing is observed; and gains [F]."""
    white, slow, memory = spectrum
    variance, found, gains = slow, np.full(len(w), np.nan), np.zeros(len(w))
    for f in range(len(w)):
        if w[f] > 0:
            found[f] = w[f] * variance + white
            gains[f] = w[f] * variance / found[f]
        variance = memory**2 * (1 - gains[f]) * variance + (1 - memory**2) * slow
    return found, gains


def squared_innovations(at, x, w, v, spectrum, metrics):
    """Squared innovations [n], in v / v, of points [n, 3] at frames [n] of a row with weights w [F].

    The gain is that of all observed frames; an outlier moves the state less.
    """
    (variances, gains), state, found = filtered(w, spectrum), np.zeros(3), []
    for f in range(len(w)):
        if f in at:
            error, metric = x[len(found)] - state, metrics[len(found)]
            found.append(w[f] / variances[f] * (error @ metric @ error))
            state = state + gains[f] / (1 + found[-1] / (SOFT * 3 * v)) * error
        state = spectrum[2] * state
    return np.array(found)
