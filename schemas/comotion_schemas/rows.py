"""Turns ids and positions as people have them into columns of a batch."""

from dataclasses import dataclass
from typing import Any

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
    given
        Number of the given rows.
    """

    ids: NDArray[np.uint64]
    positions: NDArray[np.float32]
    sigma: float | NDArray[np.float32] | None
    dropped: dict[RejectionReason, int]
    kept: NDArray[np.intp]
    given: int

    def of(self, name: str, column: ArrayLike) -> NDArray[Any]:
        """The kept rows of another column.

        Raises
        ------
        ValueError
            If it has not a row for each of the given ones.
        """
        values = _array(name, column)
        if values.shape[:1] != (self.given,):
            raise KnownError(f"{name} has the shape {values.shape}, not {self.given} rows")
        return values[self.kept]


def usable_rows(
    ids: ArrayLike,
    positions: ArrayLike,
    sigma: float | ArrayLike | None = None,
    *,
    drop: bool = False,
    instants: bool = False,
) -> Rows:
    """Check ids and positions, and convert them.

    Parameters
    ----------
    ids
        Integers [N].
    positions
        float [N, 2 or 3]; a row with NaN means that the feature is not seen, and is left out.
    sigma
        None, a number, or float [N].
    drop
        Leave out and count rows with a negative id (``range``) or an infinite position (``non-finite``).
    instants
        The rows are of several instants, so that an id may occur again.

    Raises
    ------
    ValueError
        If the arrays do not fit each other, or a row cannot be used and is not to be left out.
    """
    numbers, states = _array("ids", ids), _array("positions", positions, np.float64)
    if numbers.size == 0 and states.size == 0:
        numbers = numbers.reshape(0).astype(np.int64)
        states = states if states.ndim == 2 and states.shape[1] in {2, 3} else np.zeros((0, 3))
    _check_shapes(numbers, states)
    with np.errstate(over="ignore"):
        usable = np.isfinite(states.astype(np.float32)).all(axis=1)
    absent = np.isnan(states).any(axis=1)
    negative = numbers < 0 if numbers.dtype.kind == "i" else np.zeros(len(numbers), bool)
    bad: dict[RejectionReason, tuple[NDArray[np.bool_], str]] = {
        "range": (negative, "is negative"),
        "non-finite": (~usable & ~absent & ~negative, "has a position that is infinite"),
    }
    for rows, words in bad.values():
        if rows.any() and not drop:
            more = f" (and {int(rows.sum()) - 1} more)" if rows.sum() > 1 else ""
            first = numbers[np.flatnonzero(rows)[0]]
            raise KnownError(f"id {first} {words}{more}; drop_invalid=True leaves such rows out")
    kept = np.flatnonzero(usable & ~negative)
    identities = numbers[kept].astype(np.uint64)
    if not instants and len(np.unique(identities)) != len(identities):
        raise KnownError("an id is used twice in one instant")
    return Rows(
        identities,
        states[kept].astype(np.float32),
        _sigma(sigma, len(states), kept),
        {reason: int(rows.sum()) for reason, (rows, _) in bad.items() if rows.any()},
        kept,
        len(states),
    )


def check_space(unit: str, dim: int | None = None) -> None:
    """Check a unit, and that it goes with a number of coordinates.

    Raises
    ------
    ValueError
        If the unit is neither ``m`` nor ``px``, or does not go with the number of coordinates.
    """
    if unit not in {"m", "px"}:
        metres = {"mm": 1000, "cm": 100, "km": 0.001}.get(unit)
        cure = f"; divide positions by {metres:g}, and give 'm'" if metres else ""
        raise KnownError(f"the unit is {unit!r}, not 'm' or 'px'{cure}")
    if dim not in {None, 2, 3}:
        raise KnownError(f"positions have {dim} coordinates, not 2 or 3")
    if unit == "px" and dim == 3:
        raise KnownError("positions in px have 2 coordinates, not 3; give unit='m' for places in space")


def _array(name: str, values: ArrayLike, dtype: type | None = None) -> NDArray[Any]:
    try:
        return np.asarray(values, dtype)
    except (TypeError, ValueError):
        raise KnownError(f"{name} are no array of numbers") from None


def _check_shapes(ids: NDArray[np.int64], positions: NDArray[np.float64]) -> None:
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        raise KnownError(f"ids are {ids.dtype} of shape {ids.shape}, not integers [N]")
    if positions.ndim != 2 or positions.shape[1] not in {2, 3}:
        raise KnownError(f"positions have the shape {positions.shape}, not [N, 2] or [N, 3]")
    if len(ids) != len(positions):
        raise KnownError(f"there are {len(ids)} ids for {len(positions)} positions")


def _sigma(
    sigma: float | ArrayLike | None, count: int, kept: NDArray[np.intp]
) -> float | NDArray[np.float32] | None:
    if sigma is None or np.isscalar(sigma):
        return sigma  # type: ignore[return-value]
    values = _array("values of sigma", sigma, np.float32)
    if values.shape != (count,):
        raise KnownError(f"sigma has the shape {values.shape}, not ({count},)")
    return values[kept]
