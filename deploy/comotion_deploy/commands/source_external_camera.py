"""``comotion source external-camera``: a fixed camera, with markers as 6-DoF features."""

from dataclasses import dataclass

from ..options import setting
from .camera_options import CameraSource


@dataclass(kw_only=True)
class ExternalCamera(CameraSource):
    """Publish features and fiducial markers of a fixed camera."""

    epilog = """
Examples:
  comotion calibrate 0 1 --target chessboard:9x6:0.025 --calibration-a a.toml --calibration-b b.yaml -o x.toml
  comotion source external-camera 1 --calibration b.yaml --extrinsics x.toml --marker-size 0.05
  comotion source external-camera workcell:truck/b --name camera-b --rate 15
"""
    name = "external"

    marker_size: float | None = setting(
        None,
        "Detect markers with a black square of this edge; they are published as NAME-markers.",
        metavar="METRES",
    )
    dictionary: str = setting(
        "4x4_50", "Marker dictionary, e.g. 4x4_50 or apriltag_36h11; an unknown name lists all."
    )

    def run(self) -> None:
        """Publish until stopped, or to the end of the recording."""
        from comotion_sources.markers import MarkerOptions

        markers = None if self.marker_size is None else MarkerOptions(self.marker_size, self.dictionary)
        self.publish(moving=False, fixed=True, markers=markers)
