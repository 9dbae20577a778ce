"""Medians of numbers of which some are unknown."""

import numpy as np

from ..arrays import Floats


def nanmedian(values: Floats, axis: int) -> Floats:
    """Median along an axis, NaN left out; NaN where all are, without a warning."""
    # NaN come last.
    ranked, count = np.sort(values, axis=axis), np.isfinite(values).sum(axis=axis, keepdims=True)
    middle = np.concatenate(
        [np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[axis] - 1)], axis
    )
    return np.asarray(np.take_along_axis(ranked, middle, axis=axis).mean(axis=axis))
