"""MuJoCo, an optional dependency, and what is read of its models."""

from types import ModuleType
from typing import Any

from numpy.polynomial import Polynomial

from comotion_schemas.errors import InputError


def require_mujoco() -> ModuleType:
    """Import MuJoCo.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise InputError("mujoco is not installed: pip install 'comotion[sim3d]'") from None
    return mujoco  # type: ignore[no-any-return]


def couplings(model: Any) -> list[tuple[int, int, Polynomial]]:
    """List the joint equalities: (dependent joint, driving joint, position of the first by the second)."""
    kind = int(require_mujoco().mjtEq.mjEQ_JOINT)
    return [
        (int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), Polynomial(model.eq_data[i, :5]))
        for i in range(model.neq)
        if int(model.eq_type[i]) == kind and model.eq_obj2id[i] >= 0
    ]
