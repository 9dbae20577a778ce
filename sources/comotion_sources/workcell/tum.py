"""Writes the frames of a workcell camera as a TUM RGB-D folder."""

from pathlib import Path

from ..cameras.tum import TumWriter
from .camera import WorkcellCamera


def write_tum(camera: WorkcellCamera, folder: Path) -> int:
    """Write all frames of an unattached camera, with calibration and truth; returns their number.

    Raises
    ------
    InputError
        If the folder exists and is not empty.
    OSError
        If it cannot be written.
    """
    count = 0
    with TumWriter(folder, camera.intrinsics, camera.extrinsics, camera.objects) as writer:
        for frame in camera:
            pose = camera.viewpoint.pose(camera.scene.configuration(frame.stamp_ns * 1e-9))
            writer.write(frame, pose)
            count += 1
    return count
