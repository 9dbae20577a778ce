"""Imports MuJoCo, an optional dependency."""

from types import ModuleType

from ..errors import InputError


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
