"""``comotion source klt``: features of a camera, tracked by Lucas-Kanade."""

from .. import options
from . import camera_options as camera
from . import source_options

EPILOG = """
Examples:

  comotion source klt 0   # a webcam, in the space klt/pixels

  comotion source klt drawer.mp4 --preview tracked.mp4

  comotion source klt rtsp://camera/stream --name door --max-features 300

  comotion source klt rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --extrinsics a.toml

  comotion source klt workcell:truck/a --name camera-a

  comotion source klt rgbd_dataset_freiburg1_xyz --calibration camera_info.yaml --moving

  comotion source klt workcell:eye-in-hand/hand --carried-by robot:3 --extrinsics mount.toml
"""


def klt(
    what: camera.What,
    name: source_options.Name = "klt",
    rate: camera.Rate = None,
    max_features: camera.MaxFeatures = 400,
    respawn_every: camera.RespawnEvery = 15,
    tracker: camera.Tracker = None,
    calibration: camera.CalibrationFile = None,
    extrinsics: camera.ExtrinsicsFile = None,
    space: camera.Space = None,
    moving: camera.Moving = False,
    poses: camera.Poses = None,
    carried_by: camera.CarriedBy = None,
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
    """Track the features of a camera, video or RGB-D recording and publish them."""
    from comotion_sources.klt.carrier import CarrierName
    from comotion_sources.klt.options import CameraOptions, Connection
    from comotion_sources.klt.pacing import Pacing
    from comotion_sources.klt.process import run

    camera.clear_frames(preview, overwrite=overwrite)
    settings = CameraOptions(
        name=name,
        tracker=camera.tracker_config(
            max_features, respawn_every, tracker, moving=moving or poses is not None or carried_by is not None
        ),
        pacing=Pacing(realtime=realtime, stamps=stamps.value, rate=rate, offset_ns=round(clock_offset * 1e9)),
        calibration=camera.read_calibration(calibration, extrinsics),
        use_depth=depth,
        space=space,
        loop=loop,
        reconnect=reconnect,
        preview=preview,
        share_preview=share_preview,
        poses=poses,
        carrier=None if carried_by is None else CarrierName.parse(carried_by),
    )
    connection = Connection(
        scene=scene,
        settings=options.session_settings(connect, listen, tls, insecure=insecure),
        ready_file=ready_file,
    )
    run(what, settings, connection)
