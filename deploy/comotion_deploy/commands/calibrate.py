"""``comotion calibrate``: the extrinsics of a second camera."""

from pathlib import Path

from ..options import Json, Tool, argument, option, setting


class Calibrate(Json, Tool):
    """Find the extrinsics of camera B from a target that cameras A and B observe."""

    epilog = """
Examples:
  comotion calibrate 0 1 --target chessboard:9x6:0.025 --calibration-a a.toml --calibration-b b.yaml -o b.toml
  comotion calibrate images/a images/b --target charuco:7x5:0.03:0.022 --calibration-a a.yaml ...
  comotion calibrate a.png b.png --target marker:0.08:apriltag_36h11 --calibration-a a.yaml ...

Targets: chessboard:COLUMNSxROWS:SQUARE, charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY],
marker:SIZE[:DICTIONARY].

With two folders, the first image of A is paired with the first of B and so on. With two devices, keep the
target at rest. Without extrinsics, A is the origin of 'world': run its source with '--extrinsics identity'.
"""

    camera_a: str = argument(..., "A", "The reference camera, as for 'comotion source klt'.")
    camera_b: str = argument(..., "B", "The camera to calibrate.")
    target: str = setting(
        ...,
        "A chessboard (its inner corners), charuco (its squares) or marker, with lengths in m; see below.",
        metavar="KIND:SIZES",
    )
    calibration_a: Path | None = option(
        None, "Intrinsics of A, and its extrinsics if it has any.", metavar="FILE"
    )
    calibration_b: Path | None = option(None, "Intrinsics of B.", metavar="FILE")
    output: Path | None = option(
        None, "File for the calibration of B. Default: print it.", "--output", "-o", metavar="FILE.toml"
    )
    views: int = option(30, "Most views of the target to use.", min=1, max=1000)
    timeout: float = option(60.0, "How long devices are looked at for the target.", min=1, metavar="SECONDS")

    def run(self) -> None:
        """Calibrate, and print or write the result."""
        from contextlib import closing

        from comotion_sources.calibration.files import Calibration, format_calibration, read_calibration
        from comotion_sources.cameras.opening import open_frames
        from comotion_sources.pair_calibration import calibrate_pair, frame_pairs, parse_target

        wanted = parse_target(self.target)
        given_a, given_b = (
            Calibration() if file is None else read_calibration(file)
            for file in (self.calibration_a, self.calibration_b)
        )
        with closing(open_frames(self.camera_a)) as a, closing(open_frames(self.camera_b)) as b:
            inner_b = given_b.intrinsics or b.intrinsics
            result = calibrate_pair(
                frame_pairs(a, b, self.timeout),
                wanted,
                given_a.intrinsics or a.intrinsics,
                inner_b,
                given_a.extrinsics or a.extrinsics,
                self.views,
            )
        text = format_calibration(inner_b, result.pose)
        if self.output is not None:
            self.output.write_text(text, encoding="utf-8")
        error_a, error_b = result.error_a, result.error_b
        values = {
            "views": result.views,
            "reprojection_error_px": {"a": error_a, "b": error_b},
            "frame": result.pose.frame,
            "translation": result.pose.translation.tolist(),
            "quaternion": result.pose.quaternion.tolist(),
        }
        self.show(
            values,
            f"# {result.views} views, reprojection error {error_a:.3f} px in A, {error_b:.3f} px in B (rms)",
            text.removesuffix("\n") if self.output is None else f"# written to {self.output}",
        )
