"""``comotion source klt``: features of a camera, tracked by Lucas-Kanade."""

from dataclasses import dataclass
from pathlib import Path

from ..options import setting
from .camera_options import CameraSource, Carried


@dataclass(kw_only=True)
class Klt(Carried, CameraSource):
    """Track the features of a camera, video or RGB-D recording and publish them."""

    epilog = """
Examples:
  comotion source klt 0   # a webcam, in the space klt/pixels
  comotion source klt drawer.mp4 --preview tracked.mp4
  comotion source klt rtsp://camera/stream --name door --max-features 300
  comotion source klt rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --extrinsics a.toml
  comotion source klt workcell:truck/a --name camera-a
  comotion source klt rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --moving
  comotion source klt workcell:eye-in-hand/hand --carried-by robot:3 --extrinsics mount.toml
"""
    name = "klt"

    poses: Path | None = setting(
        None,
        "Pose of the camera over time, as TUM RGB-D's groundtruth.txt; with --stamps original.",
        metavar="FILE",
    )
    carried_by: str | None = setting(
        None,
        "The 6-DoF feature that carries the camera, such as a link of 'source proprioception'. "
        "--extrinsics is then the pose of the camera on it.",
        metavar="SOURCE:ID",
    )

    def run(self) -> None:
        """Publish until stopped, or to the end of the recording."""
        from comotion_sources.klt.carrier import CarrierName

        carrier = None if self.carried_by is None else CarrierName.parse(self.carried_by)
        moving = self.moving or self.poses is not None or carrier is not None
        self.publish(moving=moving, carrier=carrier)
