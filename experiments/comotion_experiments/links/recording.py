"""Renders and tracks a scene with both cameras: scene and seed -> messages, cached on disk."""

from pathlib import Path
from typing import Any

from scipy.spatial.transform import Rotation

from comotion.linking import Camera
from comotion_sources.klt import TrackerConfig
from comotion_sources.workcell import Scene
from comotion_sources.workcell.atlas import build_atlas
from comotion_sources.workcell.viewpoint import calibration

from ..rendered import Sources, filmed, keep
from .setup import DEPTH_CAMERA, PLAIN_CAMERA, Setup


def record(scene: str, seed: int, setup: Setup, cache: Path | None = None) -> Sources:
    """Return the messages of both cameras by the name of the source.

    Parameters
    ----------
    scene, seed
        Of the workcell.
    setup
        Size, rate, features.
    cache
        Folder to keep messages in; what was made by other code or another set-up is not used.
    """
    return keep(cache, f"{scene}-{seed}", setup, lambda: _make(scene, seed, setup))


def plain_camera(scene: str, seed: int, setup: Setup, turned: float = 0.0) -> Camera:
    """Calibration of the camera without depth, rotated by `turned` degrees about its vertical axis."""
    intrinsics, extrinsics = calibration(Scene.named(scene, seed), "b", setup.size)
    turn = Rotation.from_matrix(extrinsics.rotation) * Rotation.from_euler("y", turned, degrees=True)
    return Camera(
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.cx,
        cy=intrinsics.cy,
        translation=tuple(extrinsics.translation.tolist()),
        quaternion=tuple(turn.as_quat().tolist()),
        frame=extrinsics.frame,
    )


def _make(name: str, seed: int, setup: Setup) -> Sources:
    scene = Scene.named(name, seed)
    atlas = build_atlas(scene.model, seed)
    config = TrackerConfig(max_features=setup.features)
    how: dict[str, Any] = {"size": setup.size, "rate": setup.rate, "seconds": setup.duration, "atlas": atlas}
    return {
        DEPTH_CAMERA: filmed(scene, "a", DEPTH_CAMERA, config, **how)[0],
        PLAIN_CAMERA: filmed(scene, "b", PLAIN_CAMERA, config, depth=False, **how)[0],
    }
