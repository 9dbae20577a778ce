"""Results as JSON has them."""

from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python


def plain(value: Any, *, without_none: bool = False) -> Any:
    """Values as JSON has them; `without_none` leaves out fields that are None.

    Dataclasses and mappings become objects, arrays and sequences lists, and numbers that are not finite null.
    """
    return to_jsonable_python(value, exclude_none=without_none, inf_nan_mode="null", fallback=_listed)


def _listed(value: Any) -> Any:
    return plain(value.tolist() if isinstance(value, np.ndarray | np.generic) else list(value))
