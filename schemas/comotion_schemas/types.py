"""Types of the fields of messages; columns of NumPy, how they are checked and encoded.

A column is encoded as a msgpack ``bin`` of a little-endian C-order array (docs/protocol.md).
"""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    StringConstraints,
    ValidationInfo,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from .text import MOST, shown

MAX_BYTES = 16 * 1024 * 1024
"""Largest message the codec takes (docs/protocol.md)."""

UNDETERMINED = 0xFFFF_FFFF
"""``track_hypothesis`` of a trajectory without a hypothesis."""

UNIT_NORM_TOLERANCE = 1e-3
"""Largest deviation of the norm of a quaternion from 1: float32 and six decimals in text pass."""

MESSAGE_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

Array = NDArray[Any]

WIRE = {"from": "wire"}
"""Validation context of a decoded payload, in which a column must be ``bin``."""


def reject(reason: str, detail: str) -> PydanticCustomError:
    """Build a pydantic error whose type is a rejection reason of the protocol."""
    # Pass the detail as a value: braces in received text must not act as template fields.
    return PydanticCustomError(reason, "{detail}", {"detail": detail})  # type: ignore[arg-type,unused-ignore]


@dataclass(frozen=True, slots=True)
class Column:
    """A column: dtype, row width and whether NaN and infinity are rejected."""

    dtype: str  # NumPy type string with byte order, e.g. ``<u8``
    # Values per row; None for a vector, a text for what follows from the field ``dim`` of the message.
    width: int | str | None = None
    finite: bool = True  # reject NaN and infinity
    # Bounds of the values, the last one exclusive; None: none.
    least: float | None = None
    most: float | None = None
    above: float | None = None
    distinct: bool = False  # reject a value that occurs twice

    def validate(self, value: object, info: ValidationInfo) -> Array:
        """Convert an array-like, or of a decoded payload bytes, to a read-only array of the column's dtype.

        Raises
        ------
        PydanticCustomError
            ``length`` for bytes that are not a whole number of rows, or an array of another shape;
            ``non-finite`` for numbers that must be finite; ``range`` for integers that do not fit and
            values beyond a bound; ``duplicate-id`` for values that occur twice; ``schema`` for anything that
            is not an array of numbers.
        """
        if info.context is WIRE and not isinstance(value, bytes):
            raise reject("schema", f"a column is bin, not {type(value).__name__}")
        dim = (info.data or {}).get("dim", 3)
        texts = {"dim": dim, "dim (dim + 1) / 2": dim * (dim + 1) // 2}
        width = texts[self.width] if isinstance(self.width, str) else self.width
        array = self._from_bytes(value, width) if isinstance(value, bytes) else self._from_array(value, width)
        if self.finite and array.dtype.kind == "f" and not np.isfinite(array).all():
            raise reject("non-finite", "numbers must be finite")
        if self.above is not None and (array <= self.above).any():
            raise reject("range", f"a value is not above {self.above:g}")
        if self.least is not None and (array < self.least).any():
            raise reject("range", f"a value is below {self.least:g}")
        if self.most is not None and (array > self.most).any():
            raise reject("range", f"a value is above {self.most:g}")
        if self.distinct and has_duplicates(array):
            raise reject("duplicate-id", "an id occurs twice")
        return array

    def _from_bytes(self, raw: bytes, width: int | None) -> Array:
        dtype = np.dtype(self.dtype)
        if len(raw) % (dtype.itemsize * (width or 1)):
            raise reject("length", f"{len(raw)} bytes are not a whole number of rows of {width or 1} {dtype}")
        flat = np.frombuffer(raw, dtype)
        return flat.reshape(-1, width) if width else flat

    def _from_array(self, value: object, width: int | None) -> Array:
        target = np.dtype(self.dtype)
        try:
            given = np.asarray(value)
            if given.dtype.kind == "f" and isinstance(value, list) and all(type(v) is int for v in value):
                given = np.array(value, target)  # NumPy converts lists beyond int64 to floats
            if given.size and given.dtype.kind not in ("iuf" if target.kind == "f" else "iu"):
                raise reject("schema", f"{given.dtype} for a column of {target}")
            # The finite check reports an overflow to infinity.
            with np.errstate(over="ignore"):
                array = np.array(given, target, order="C")
        except (TypeError, ValueError, OverflowError) as error:
            raise reject("schema", f"not an array of {self.dtype}: {error}") from None
        if target.kind != "f" and (array != given).any():
            raise reject("range", f"an integer does not fit in {target}")
        if not array.size:
            array = array.reshape((0, width) if width else 0)
        rank = 2 if width else 1
        if array.ndim != rank:
            raise reject("length", f"expected {rank} dimensions, got {array.ndim}")
        if width and array.shape[1] != width:
            raise reject("length", f"expected rows of {width}, got {array.shape[1]}")
        array.flags.writeable = False
        return array

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate through :meth:`validate`."""
        return core_schema.with_info_plain_validator_function(self.validate)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Describe the field as bytes, with the array layout as extension keys."""
        shape = ["N"] if self.width is None else ["N", self.width]
        return {"type": "string", "contentEncoding": "binary", "x-dtype": self.dtype, "x-shape": shape}


def increasing(ids: Array) -> bool:
    """Whether ids uint64 [N] are strictly increasing."""
    return bool((ids[1:] > ids[:-1]).all())


def has_duplicates(ids: Array) -> bool:
    """Whether an id occurs twice; sorted ids, the common case, are not sorted again."""
    if ids.size < 2 or increasing(ids):
        return False
    ordered = np.sort(ids)
    return bool((ordered[1:] == ordered[:-1]).any())


def symmetric(upper: NDArray[np.float64]) -> NDArray[np.float64]:
    """Symmetric matrices [N, dim, dim] of their upper triangles [N, 6] (3-D) or [N, 3] (2-D), row by row."""
    dim = 3 if upper.shape[1] == 6 else 2
    rows, columns = np.triu_indices(dim)
    matrices = np.zeros((len(upper), dim, dim))
    matrices[:, rows, columns] = matrices[:, columns, rows] = upper
    return matrices


class Rowwise:
    """Base of messages with columns: each has a row for each element of one field."""

    _OTHERS: ClassVar = frozenset({"ended"})  # columns of their own length
    _of: ClassVar[str] = "ids"

    def __post_init__(self) -> None:
        expected = len(getattr(self, self._of))
        for name, column in vars(self).items():
            if isinstance(column, np.ndarray) and len(column) != expected and name not in self._OTHERS:
                raise reject("length", f"{name} has {len(column)} rows, expected {expected}")


# [0-9a-z_-] with an explicit end: `$` would also match before a trailing newline.
_NAME = r"[a-z0-9_-]{1,64}"


def _printable(name: str) -> str:
    """Refuse a name that cannot be shown: changed, it would be that of something else."""
    if not name.isprintable():
        raise reject("schema", "it holds characters that cannot be shown")
    return name


# NumPy scalars are plain numbers.
_PLAIN = BeforeValidator(lambda value: value.item() if isinstance(value, np.generic) else value)
Int64 = Annotated[int, Field(strict=True, ge=-(2**63), le=2**63 - 1), _PLAIN]
UInt64 = Annotated[int, Field(strict=True, ge=0, le=2**64 - 1), _PLAIN]
UInt32 = Annotated[int, Field(strict=True, ge=0, le=2**32 - 1), _PLAIN]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False), _PLAIN]
Count = UInt64

Name = Annotated[str, StringConstraints(strict=True, pattern=rf"^{_NAME}\z")]
SessionId = Annotated[str, StringConstraints(strict=True, pattern=r"^[0-9a-f]{16}\z")]
SpaceName = Annotated[
    str, StringConstraints(strict=True, min_length=1, max_length=256), AfterValidator(_printable)
]
ShortText = Annotated[str, StringConstraints(strict=True, max_length=MOST), AfterValidator(shown)]
"""Whatever is received, decoded text can be shown."""
Unit = Literal["m", "px"]

IdColumn = Annotated[NDArray[np.uint64], Column("<u8")]
F8Column = Annotated[NDArray[np.float64], Column("<f8")]
DistinctIds = Annotated[NDArray[np.uint64], Column("<u8", distinct=True)]


def is_name(value: str) -> bool:
    """Whether a name of a scene, source or component is of the form ``[a-z0-9_-]{1,64}``."""
    return re.fullmatch(_NAME, value) is not None


class Record:
    """A map inside a message whose fields that `_spatial` names, where they are set, are of one dimension."""

    _spatial: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        dims = {dimension(value) for name in self._spatial if (value := getattr(self, name)) is not None}
        if len(dims) > 1:
            raise reject("length", f"{', '.join(self._spatial)} differ in dimension")

    @classmethod
    def trusted(cls, **values: Any) -> Self:
        """Build a record of values that are known to be valid; checks only that numbers are finite."""
        for value in values.values():
            number = sum(value) if isinstance(value, list) else value
            if isinstance(number, float) and not math.isfinite(number):
                raise reject("non-finite", "numbers must be finite")
        record = object.__new__(cls)
        vars(record).update(values)
        return record


def dimension(value: "list[float] | float | Record") -> int:
    """Dimension of a vector, a turn (a quaternion, or in 2-D an angle), or a record of them."""
    if isinstance(value, list):
        return min(len(value), 3)
    return dimension(getattr(value, value._spatial[0])) if isinstance(value, Record) else 2
