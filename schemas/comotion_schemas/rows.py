"""Turns ids and positions as people have them into columns of a batch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import KnownError
from .messages import RejectionReason


@dataclass(frozen=True)
class Rows:
    """Usable rows."""

    # uint64 [N], and float32 [N, 2 or 3], finite.
    ids: NDArray[np.uint64]
    positions: NDArray[np.float32]
    columns: dict[str, Any]  # numbers, and arrays [N, ...], by their names
    dropped: dict[RejectionReason, int]  # rows that were left out, by reason


def usable_rows(
    ids: ArrayLike,
    positions: ArrayLike,
    columns: Mapping[str, ArrayLike | None],
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
    columns
        By their names, numbers and other arrays [N, ...]; those that are None are left out.
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
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        raise KnownError(f"ids are {numbers.dtype} of shape {numbers.shape}, not integers [N]")
    if states.ndim != 2 or states.shape[1] not in {2, 3}:
        raise KnownError(f"positions have the shape {states.shape}, not [N, 2] or [N, 3]")
    if len(numbers) != len(states):
        raise KnownError(f"there are {len(numbers)} ids for {len(states)} positions")
    with np.errstate(over="ignore"):
        usable = np.isfinite(states.astype(np.float32)).all(axis=1)
    negative = numbers < 0
    bad: dict[RejectionReason, tuple[NDArray[np.bool_], str]] = {
        "range": (negative, "is negative"),
        "non-finite": (
            ~(usable | np.isnan(states).any(axis=1) | negative),
            "has a position that is infinite",
        ),
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
    given = {name: _array(name, column) for name, column in columns.items() if column is not None}
    for name, column in given.items():
        if column.ndim and len(column) != len(numbers):
            raise KnownError(f"{name} has the shape {column.shape}, not {len(numbers)} rows")
    return Rows(
        identities,
        states[kept].astype(np.float32),
        {name: column[kept] if column.ndim else columns[name] for name, column in given.items()},
        {reason: int(rows.sum()) for reason, (rows, _) in bad.items() if rows.any()},
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
