"""Ids and positions as people have them in, usable columns of a batch out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import KnownError
from .messages import RejectionReason


@dataclass(frozen=True)
class Rows:
    """Usable rows.

    Attributes
    ----------
    ids, positions
        uint64 [N], and float32 [N, 2 or 3], finite.
    sigma
        A number, float32 [N], or None.
    dropped
        Rows that were left out, by reason.
    kept
        intp [N], which of the given rows they are.
    """

    ids: NDArray[np.uint64]
    positions: NDArray[np.float32]
    sigma: float | NDArray[np.float32] | None
    dropped: dict[RejectionReason, int]
    kept: NDArray[np.intp]


def usable_rows(
    ids: ArrayLike,
    positions: ArrayLike,
    sigma: float | ArrayLike | None = None,
    *,
    unseen: bool = False,
    drop: bool = False,
    instants: bool = False,
) -> Rows:
    """Check ids and positions, and convert them.

    Parameters
    ----------
    ids
        Integers [N].
    positions
        float [N, 2 or 3].
    sigma
        None, a number, or float [N].
    unseen
        A row of NaN means that the feature is not seen; it is left out and not counted.
    drop
        Leave out and count rows with a negative id (``range``) or a position that is not finite
        (``non-finite``).
    instants
        The rows are of several instants, so that an id may occur again.

    Raises
    ------
    ValueError
        If the arrays do not fit each other, or a row cannot be used and is not to be left out.
    """
    numbers, states = np.asarray(ids), np.asarray(positions, np.float64)
    if numbers.size == 0 and states.size == 0:
        numbers = numbers.reshape(0).astype(np.int64)
        states = states if states.ndim == 2 and states.shape[1] in {2, 3} else np.zeros((0, 3))
    _check_shapes(numbers, states)
    with np.errstate(over="ignore"):
        usable = np.isfinite(states.astype(np.float32)).all(axis=1)
    absent = np.isnan(states).all(axis=1) if unseen else np.zeros(len(states), bool)
    negative = numbers < 0 if numbers.dtype.kind == "i" else np.zeros(len(numbers), bool)
    bad: dict[RejectionReason, NDArray[np.bool_]] = {
        "range": negative,
        "non-finite": ~usable & ~absent & ~negative,
    }
    if not drop:
        _refuse(numbers, bad)
    kept = np.flatnonzero(usable & ~negative)
    found = numbers[kept].astype(np.uint64)
    if not instants and len(np.unique(found)) != len(found):
        raise KnownError("an id is used twice in one instant")
    return Rows(
        found,
        states[kept].astype(np.float32),
        _sigma(sigma, len(states), kept),
        {reason: int(rows.sum()) for reason, rows in bad.items() if rows.any()},
        kept,
    )


def _check_shapes(ids: NDArray[np.int64], positions: NDArray[np.float64]) -> None:
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        raise KnownError(f"ids are {ids.dtype} of shape {ids.shape}, not integers [N]")
    if positions.ndim != 2 or positions.shape[1] not in {2, 3}:
        raise KnownError(f"positions have the shape {positions.shape}, not [N, 2] or [N, 3]")
    if len(ids) != len(positions):
        raise KnownError(f"there are {len(ids)} ids for {len(positions)} positions")


def _refuse(ids: NDArray[np.int64], bad: dict[RejectionReason, NDArray[np.bool_]]) -> None:
    words: dict[RejectionReason, str] = {
        "range": "is negative",
        "non-finite": "has a position that is not finite",
    }
    for reason, rows in bad.items():
        if rows.any():
            first = int(ids[np.flatnonzero(rows)[0]])
            more = f" (and {int(rows.sum()) - 1} more)" if rows.sum() > 1 else ""
            raise KnownError(f"id {first} {words[reason]}{more}; drop_invalid=True leaves such rows out")


def _sigma(
    sigma: float | ArrayLike | None, count: int, kept: NDArray[np.intp]
) -> float | NDArray[np.float32] | None:
    if sigma is None or np.isscalar(sigma):
        return sigma  # type: ignore[return-value]
    values = np.asarray(sigma, np.float32)
    if values.shape != (count,):
        raise KnownError(f"sigma has the shape {values.shape}, not ({count},)")
    return values[kept]
