"""``--camera`` of ``comotion serve``: calibrated cameras whose hypotheses are linked to bodies in 3-D."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UserError
from .camera_sources import read_calibration

if TYPE_CHECKING:
    from comotion import FusionConfig
    from comotion.linking import Camera
    from comotion_sources.calibration import Calibration

_WORKCELL = "workcell:"


def with_cameras(config: "FusionConfig", texts: list[str] | None) -> "FusionConfig":
    """Add calibrated cameras to the fusion parameters.

    Raises
    ------
    UserError
        If a camera is malformed, or has no intrinsics or extrinsics.
    ValueError
        If a file, or the name of a simulated camera, is wrong.
    """
    from comotion.config import LinkingConfig

    cameras = dict(_camera(text) for text in texts or ())
    if not cameras:
        return config
    return config.model_copy(update={"linking": LinkingConfig(cameras=config.linking.cameras | cameras)})


def _camera(text: str) -> "tuple[str, Camera]":
    """Parse NAME=FILE[,FILE] to the name of the space and the camera."""
    from comotion.linking import Camera

    name, separator, where = text.partition("=")
    if not (name and separator and where):
        raise UserError(f"--camera {text}: expected NAME=FILE, or NAME=INTRINSICS,EXTRINSICS")
    calibration = _workcell(where) if where.startswith(_WORKCELL) else _from_files(where)
    inner, outer = calibration.intrinsics, calibration.extrinsics
    if inner is None or outer is None:
        raise UserError(f"--camera {text}: has no {'intrinsics' if inner is None else 'extrinsics'}")
    return name if "/" in name else f"{name}/pixels", Camera(
        fx=inner.fx,
        fy=inner.fy,
        cx=inner.cx,
        cy=inner.cy,
        distortion=tuple(inner.distortion.tolist()),
        translation=tuple(outer.translation.tolist()),
        quaternion=tuple(outer.quaternion.tolist()),
        frame=outer.frame,
    )


def _from_files(where: str) -> "Calibration":
    inner, comma, outer = where.partition(",")
    return read_calibration(Path(inner), Path(outer) if comma else None)


def _workcell(what: str) -> "Calibration":
    from comotion_sources.calibration import Calibration
    from comotion_sources.workcell.camera import parse
    from comotion_sources.workcell.scene import Scene
    from comotion_sources.workcell.viewpoint import calibration

    spec = parse(what)
    return Calibration(*calibration(Scene(spec.scene, spec.seed), spec.camera, spec.size))
