"""Field types shared by several messages."""

import re
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Discriminator, Field, StringConstraints, Tag

from .columns import Column, reject
from .text import MOST, shown

MAX_BYTES = 16 * 1024 * 1024
"""Largest message the codec takes (docs/protocol.md)."""

UNDETERMINED = 0xFFFF_FFFF
"""``track_hypothesis`` of a trajectory without a hypothesis."""

UNIT_NORM_TOLERANCE = 1e-3
"""Largest deviation of the norm of a quaternion from 1: float32 and six decimals in text pass."""

MESSAGE_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

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
StampColumn = Annotated[NDArray[np.int64], Column("<i8")]
F8Column = Annotated[NDArray[np.float64], Column("<f8")]
DistinctIds = Annotated[NDArray[np.uint64], Column("<u8", distinct=True)]
ObjectColumn = Annotated[NDArray[np.int32], Column("<i4", least=-1)]
ShareColumn = Annotated[NDArray[np.float32], Column("<f4", least=0, most=1)]
U2Column = Annotated[NDArray[np.uint16], Column("<u2")]
U4Column = Annotated[NDArray[np.uint32], Column("<u4")]
PositionColumn = Annotated[NDArray[np.float32], Column("<f4", "dim")]
CovarianceColumn = Annotated[NDArray[np.float32], Column("<f4", "dim (dim + 1) / 2")]
PixelColumn = Annotated[NDArray[np.float32], Column("<f4", 2)]
PointColumn = Annotated[NDArray[np.float32], Column("<f4", 3, finite=False)]
QuaternionColumn = Annotated[NDArray[np.float32], Column("<f4", 4, finite=False)]
Sigma = Annotated[
    Annotated[Finite, Field(gt=0), Tag("number")]
    | Annotated[NDArray[np.float32], Column("<f4", above=0), Tag("column")],
    Discriminator(lambda value: "number" if isinstance(value, int | float | np.number) else "column"),
]
"""One number for all rows, or one for each."""


def is_name(value: str) -> bool:
    """Whether a name of a scene, source or component is of the form ``[a-z0-9_-]{1,64}``."""
    return re.fullmatch(_NAME, value) is not None


class Record:
    """A map inside a message whose fields that `_spatial` names, where they are set, are of one dimension."""

    _spatial: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        values = (getattr(self, name) for name in self._spatial)
        if len({dimension(value) for value in values if value is not None}) > 1:
            raise reject("length", f"{', '.join(self._spatial)} differ in dimension")


def dimension(value: "list[float] | float | Record") -> int:
    """Dimension of a vector, a turn (a quaternion, or in 2-D an angle), or a record of them."""
    if isinstance(value, Record):
        return dimension(getattr(value, value._spatial[0]))
    return min(len(value), 3) if isinstance(value, list) else 2
