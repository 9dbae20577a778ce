"""``comotion source external-camera``: a fixed camera, with markers as 6-DoF features."""

from typing import Annotated

import typer

from .. import options
from . import camera_options as camera
from . import source_options

EPILOG = """
Examples:

  comotion calibrate 0 1 --target chessboard:9x6:0.025 --calibration-a a.toml --calibration-b b.yaml -o x.toml

  comotion source external-camera 1 --calibration b.yaml --extrinsics x.toml --marker-size 0.05

  comotion source external-camera workcell:truck/b --name camera-b --rate 15
"""


def external_camera(
    what: camera.What,
    name: source_options.Name = "external",
    rate: camera.Rate = None,
    marker_size: Annotated[
        float | None,
        typer.Option(
            "--marker-size",
            envvar="COMOTION_MARKER_SIZE",
            metavar="METRES",
            help="Detect markers with a black square of this edge; they are published as NAME-markers.",
        ),
    ] = None,
    dictionary: Annotated[
        str,
        typer.Option(
            "--dictionary",
            envvar="COMOTION_DICTIONARY",
            help="Marker dictionary, e.g. 4x4_50 or apriltag_36h11; an unknown name lists all.",
        ),
    ] = "4x4_50",
    max_features: camera.MaxFeatures = 400,
    respawn_every: camera.RespawnEvery = 15,
    tracker: camera.Tracker = None,
    calibration: camera.CalibrationFile = None,
    extrinsics: camera.ExtrinsicsFile = None,
    space: camera.Space = None,
    depth: camera.Depth = True,
    preview: camera.PreviewPath = None,
    overwrite: camera.Overwrite = False,
    share_preview: camera.SharePreview = 5.0,
    realtime: camera.Realtime = True,
    loop: camera.Loop = False,
    stamps: camera.Stamps = source_options.StampChoice.NOW,
    reconnect: camera.Reconnect = True,
    clock_offset: camera.ClockOffset = 0.0,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    listen: options.Listen = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    insecure: options.Insecure = False,
    _log_level: options.Log = options.LogLevel.INFO,
    _metrics: options.Metrics = None,
) -> None:
    """Publish features and fiducial markers of a fixed camera."""
    from comotion_sources.klt.options import CameraOptions, Connection
    from comotion_sources.klt.pacing import Pacing
    from comotion_sources.klt.process import run
    from comotion_sources.markers import MarkerOptions

    camera.clear_frames(preview, overwrite=overwrite)
    settings = CameraOptions(
        name=name,
        tracker=camera.tracker_config(max_features, respawn_every, tracker),
        pacing=Pacing(realtime=realtime, stamps=stamps.value, rate=rate, offset_ns=round(clock_offset * 1e9)),
        calibration=camera.read_calibration(calibration, extrinsics),
        use_depth=depth,
        space=space,
        fixed=True,
        loop=loop,
        reconnect=reconnect,
        preview=preview,
        share_preview=share_preview,
        markers=None if marker_size is None else MarkerOptions(marker_size, dictionary),
    )
    connection = Connection(
        scene=scene,
        settings=options.session_settings(connect, listen, tls, insecure=insecure),
        ready_file=ready_file,
    )
    run(what, settings, connection)
