"""``comotion calibrate``: the extrinsics of a second camera."""

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..errors import UserError

EPILOG = """
Examples:

  comotion calibrate 0 1 --target chessboard:9x6:0.025 --calibration-a a.toml --calibration-b b.yaml -o b.toml

  comotion calibrate images/a images/b --target charuco:7x5:0.03:0.022 --calibration-a a.yaml ...

  comotion calibrate a.png b.png --target marker:0.08:apriltag_36h11 --calibration-a a.yaml ...

With two folders, the first image of A is paired with the first of B and so on. With two devices, keep the
target at rest. Without extrinsics, A is the origin of 'world': run its source with '--extrinsics identity'.
"""


def calibrate(
    camera_a: Annotated[
        str, typer.Argument(metavar="A", help="The reference camera, as for 'comotion source klt'.")
    ],
    camera_b: Annotated[str, typer.Argument(metavar="B", help="The camera to calibrate.")],
    target: Annotated[
        str,
        typer.Option(
            "--target",
            envvar="COMOTION_TARGET",
            metavar="KIND:SIZES",
            help="chessboard:COLUMNSxROWS:SQUARE (inner corners, m), "
            "charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] (squares, m), marker:SIZE[:DICTIONARY].",
        ),
    ],
    calibration_a: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Intrinsics of A, and its extrinsics if it has any."),
    ] = None,
    calibration_b: Annotated[Path | None, typer.Option(metavar="FILE", help="Intrinsics of B.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE.toml", help="File for the calibration of B. Default: print it."
        ),
    ] = None,
    views: Annotated[int, typer.Option(min=1, max=1000, help="Most views of the target to use.")] = 30,
    timeout: Annotated[
        float, typer.Option(min=1, help="Seconds to look for the target with devices.")
    ] = 60.0,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Find the extrinsics of camera B from a target that cameras A and B observe."""
    from contextlib import closing

    from comotion_sources.calibration import Calibration, format_calibration, read_calibration
    from comotion_sources.cameras import open_frames
    from comotion_sources.pair_calibration.session import calibrate_pair, frame_pairs, known_intrinsics
    from comotion_sources.pair_calibration.targets import parse_target

    wanted = parse_target(target)
    given_a = Calibration() if calibration_a is None else read_calibration(calibration_a)
    given_b = Calibration() if calibration_b is None else read_calibration(calibration_b)
    with closing(open_frames(camera_a)) as a, closing(open_frames(camera_b)) as b:
        inner_b = known_intrinsics("B", given_b.intrinsics, b)
        result = calibrate_pair(
            frame_pairs(a, b, timeout),
            wanted,
            known_intrinsics("A", given_a.intrinsics, a),
            inner_b,
            given_a.extrinsics or a.extrinsics,
            views,
        )
    text = format_calibration(inner_b, result.extrinsics)
    if output is not None:
        try:
            output.write_text(text, encoding="utf-8")
        except OSError as error:
            raise UserError(f"{output}: {error.strerror}") from None
    error_a, error_b = result.fit.error_a, result.fit.error_b
    if json_:
        print(
            json.dumps(
                {
                    "views": result.views,
                    "reprojection_error_px": {"a": error_a, "b": error_b},
                    "frame": result.extrinsics.frame,
                    "translation": result.extrinsics.translation.tolist(),
                    "quaternion": result.extrinsics.quaternion.tolist(),
                }
            )
        )
        return
    print(f"# {result.views} views, reprojection error {error_a:.3f} px in A, {error_b:.3f} px in B (rms)")
    print(text if output is None else f"# written to {output}", end="" if output is None else "\n")
