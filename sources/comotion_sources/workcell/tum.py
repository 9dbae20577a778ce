"""Writes what a workcell camera sees as a TUM RGB-D folder, for tools that run on files.

Layout of the data set's own tools: ``rgb/STAMP.png``, ``depth/STAMP.png`` (uint16, metres times 5000,
0 = missing), ``rgb.txt`` and ``depth.txt`` ("stamp path" per line, stamps in seconds),
``groundtruth.txt`` (the camera's pose: stamp tx ty tz qx qy qz qw). Beside them, what the layout has
no place for: ``camera_info.yaml`` (ROS), and the truth: ``objects/STAMP.png`` (uint16, object number
plus one, 0 = unknown) with ``objects.txt`` ("number name" per line).
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from ..cameras.types import Frame
from ..errors import SceneError
from .camera import WorkcellCamera

DEPTH_SCALE = 5000.0


def write_tum(camera: WorkcellCamera, folder: Path) -> int:
    """Write all frames of an unattached camera; answers with how many there are.

    Raises
    ------
    SceneError
        If the folder exists and is not empty.
    OSError
        If it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SceneError(f"{folder}: exists already")
    for name in ("rgb", "depth", "objects"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    _write_calibration(camera, folder)
    pose = " ".join(f"{v:.9f}" for v in (*camera.extrinsics.translation, *camera.extrinsics.quaternion))
    lists = {"rgb": "# color images\n", "depth": "# depth maps\n", "groundtruth": "# camera pose\n"}
    count = 0
    for stamp, frame in _stamped(camera):
        count += 1
        _write_frame(frame, folder, stamp)
        for name in ("rgb", "depth"):
            lists[name] += f"{stamp} {name}/{stamp}.png\n"
        lists["groundtruth"] += f"{stamp} {pose}\n"
    for name, lines in lists.items():
        (folder / f"{name}.txt").write_text(lines)
    return count


def _stamped(camera: WorkcellCamera) -> Iterator[tuple[str, Frame]]:
    for frame in camera:
        yield f"{frame.stamp_ns / 1e9:.6f}", frame


def _write_frame(frame: Frame, folder: Path, stamp: str) -> None:
    assert frame.depth is not None  # noqa: S101 - every workcell frame has both
    assert frame.objects is not None  # noqa: S101
    depth = np.clip(np.rint(frame.depth * DEPTH_SCALE), 0, 65535).astype(np.uint16)
    images = {"rgb": frame.image, "depth": depth, "objects": (frame.objects + 1).astype(np.uint16)}
    for name, image in images.items():
        path = folder / name / f"{stamp}.png"
        if not cv2.imwrite(str(path), image):
            raise OSError(f"{path}: cannot be written")


def _write_calibration(camera: WorkcellCamera, folder: Path) -> None:
    k = camera.intrinsics
    (folder / "camera_info.yaml").write_text(
        f"image_width: {k.width}\n"
        f"image_height: {k.height}\n"
        f"camera_name: {camera.spec.scene}_{camera.spec.camera}\n"
        "distortion_model: plumb_bob\n"
        f"camera_matrix: {{rows: 3, cols: 3, data: [{k.fx}, 0, {k.cx}, 0, {k.fy}, {k.cy}, 0, 0, 1]}}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    names = "".join(f"{number} {name}\n" for number, name in camera.objects.items())
    (folder / "objects.txt").write_text(names)
