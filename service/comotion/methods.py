"""Chooses the method that groups the trajectories of a space."""

from .config import FusionConfig
from .partition import Method, SpaceSpec
from .pixels.method import PixelMethod
from .rigid.method import RigidMethod


def make_method(config: FusionConfig, spec: SpaceSpec) -> Method:
    """Build the method of `config.method` for one space."""
    # Pixels with a third coordinate (a disparity) are no image plane: rigid motion is the better model.
    if config.method == "comotion" and spec.unit == "px" and spec.dim == 2:
        return PixelMethod(config, spec)
    if config.method == "comotion":
        return RigidMethod(config, spec)
    # Its clustering imports scikit-learn, which takes half a second that the others do not need.
    from .thesis.method import ThesisMethod  # noqa: PLC0415

    return ThesisMethod(config, spec)
