"""The process of a camera source: reads a camera, tracks its features and publishes them."""

import logging
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Unpack

import cv2

from comotion_schemas.component import Where
from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics
from ..cameras.opening import open_frames
from ..cameras.types import Camera, Frame
from ..markers import publish_markers
from ..poses import Carrier, PoseBuffer, read_trajectory
from ..runtime import SourcePublisher
from .drawing import Annotator
from .observer import CameraSpace, Observer, choose_space
from .options import CameraOptions, Pacer
from .picture_file import NO_ENCODER, PictureFile
from .preview import DelayedPreview, PreviewStream
from .tracker import Tracker, Tracks

_RETRY_S = 1.0  # between two attempts to reopen a lost device
_DEFAULT_RATE = 30.0
_log = logging.getLogger(__name__)


def run(what: str, options: CameraOptions, **where: Unpack[Where]) -> None:
    """Publish the observations of a camera until it ends or a signal arrives.

    `what` is a camera, as in :func:`open_frames`.

    Raises
    ------
    InputError
        If the camera or recording cannot be opened or read, or the calibration is missing or does not fit.
    """
    cv2.setNumThreads(1)  # the work of one frame is too small to be worth waking other cores for
    CameraProcess(what, open_frames(what, options.rate), options, where).run()


class CameraProcess:
    """One camera source; see :func:`run`."""

    def __init__(self, what: str, camera: Camera, options: CameraOptions, where: Where) -> None:
        self._what, self._camera, self._options, self._where = what, camera, options, where
        given = options.calibration
        self._intrinsics = given.intrinsics or camera.intrinsics
        self._extrinsics = given.extrinsics or camera.extrinsics
        self._space = self._choose_space()
        self._tracker = Tracker(options.tracker, self._space.intrinsics)
        self._poses: PoseBuffer | None = None
        if options.poses is not None:
            self._poses = read_trajectory(options.poses, self._extrinsics)
        self._events = {"frames": 0, "depth_missing": 0, "resets": 0, "reconnects": 0}
        self._size: tuple[int, ...] | None = None
        self._stamp_ns: int | None = None
        # What else takes each frame with its features.
        self._outputs: list[Callable[[Frame, Tracks], None]] = []

    def run(self) -> None:
        """Publish until the camera ends or the process is stopped."""
        with ExitStack() as stack:
            stack.callback(lambda: self._camera.close())  # noqa: PLW0108 - a lost camera is replaced
            self._connect(stack)
            self._publisher.ready()
            self._play()
            self._end_features()
        counts = ", ".join(f"{name} {count}" for name, count in self._counters().items() if count)
        _log.info("%s: ended; %s", self._what, counts)

    def _choose_space(self) -> CameraSpace:
        options, has_depth = self._options, self._camera.has_depth and self._options.use_depth
        if options.posed:
            if not has_depth or self._intrinsics is None:
                raise InputError("poses need a camera with depth and intrinsics: --calibration FILE")
            return CameraSpace(options.space or "world", "m", 3, self._intrinsics)
        if options.fixed and self._extrinsics is None and (has_depth or options.markers is not None):
            raise InputError(
                "an external camera needs its extrinsics: --extrinsics FILE ('comotion calibrate' makes it)"
            )
        return choose_space(
            options.name,
            has_depth=has_depth,
            intrinsics=self._intrinsics,
            extrinsics=self._extrinsics,
            name=options.space,
        )

    def _connect(self, stack: ExitStack) -> None:
        options, rate = self._options, self._options.rate or self._camera.rate or _DEFAULT_RATE
        if options.markers is not None:
            name, frame = options.name, self._extrinsics or Extrinsics(frame=f"{options.name}/optical")
            where: Where = {**self._where, "ready_file": None}
            publish = publish_markers(
                stack, f"{name}-markers", options.markers, self._intrinsics, frame, rate=rate, **where
            )
            self._outputs.append(publish)
        # Signals reach the component that was entered last.
        self._publisher = stack.enter_context(
            SourcePublisher(
                options.name,
                space=self._space.name,
                unit=self._space.unit,
                dim=self._space.dim,
                rate=rate,
                message=f"{self._what} in {self._space.name}",
                moving=options.tracker.moving and not options.posed,
                **self._where,
            )
        )
        if options.carrier is not None:
            self._poses = Carrier(self._publisher, *options.carrier, self._extrinsics)
        self._observer = Observer(self._space, self._publisher.builder, self._camera.objects, self._poses)
        self._pacer = Pacer(options, self._camera.live, self._publisher.stop.wait)
        self._publisher.more_counters = self._counters
        if options.share_preview > 0:
            self._outputs.append(PreviewStream(self._publisher, options.share_preview).offer)
        if options.preview is not None:
            file = PictureFile(options.preview, rate)
            if file.codec == "mpeg4":
                _log.warning("%s: %s", options.preview, NO_ENCODER)
            preview = DelayedPreview(file, Annotator(self._space), self._publisher)
            stack.callback(preview.close)
            self._outputs.append(preview.add)
        self._attach()

        def close_on_stop() -> None:
            self._publisher.stop.wait()
            self._camera.close()  # ends its wait for a frame

        threading.Thread(target=close_on_stop, name="closer", daemon=True).start()

    def _attach(self) -> None:
        self._camera.attach(self._publisher)
        self._pacer.live = self._camera.live

    def _counters(self) -> dict[str, int]:
        camera = dict(self._camera.counters)
        camera.pop("depth_missing", None)  # self._events counts it for every kind of camera
        unposed = {} if self._poses is None else {"unposed": self._observer.unposed}
        return {"tracks": self._tracker.count} | unposed | camera | self._pacer.counters | self._events

    def _play(self) -> None:
        stop = self._publisher.stop
        while not stop.is_set():
            try:
                for frame in self._camera:
                    self._process(frame)
                    if stop.is_set():
                        return
            except InputError as error:
                if not (self._camera.live and self._options.reconnect):
                    raise
                self._recover(error)
                continue
            if self._camera.live or not self._options.loop:
                return
            self._end_features()
            self._pacer.rewind(round(1e9 / (self._camera.rate or _DEFAULT_RATE)))

    def _process(self, frame: Frame) -> None:
        stamp = self._pacer.admit(frame.stamp_ns)
        if stamp is None or self._publisher.stop.is_set():
            return
        if self._stamp_ns is not None and stamp <= self._stamp_ns:
            self._end_features()  # the clock of the device was set back
        self._check_size(frame)
        self._check_depth(frame)
        self._events["frames"] += 1
        self._stamp_ns = stamp
        depth = frame.depth if self._space.dim == 3 else None
        seen = Frame(stamp, frame.image, depth, frame.objects)
        tracks = self._tracker.step(seen)
        for message in self._observer.messages(tracks, seen):
            self._publisher.put(message)
        for output in self._outputs:
            output(seen, tracks)

    def _check_size(self, frame: Frame) -> None:
        size = frame.image.shape[:2]
        if size == self._size:
            return
        if self._size is not None:
            _log.warning("%s: the image size has changed; all features end", self._what)
            self._events["resets"] += 1
            self._end_features()
        self._size = size
        needed = self._space.intrinsics or (self._intrinsics if self._options.markers else None)
        if needed is not None and (needed.height, needed.width) != size:
            raise InputError(
                f"{self._what}: images of {size[1]} x {size[0]}, "
                f"but the calibration is for {needed.width} x {needed.height}"
            )

    def _check_depth(self, frame: Frame) -> None:
        if self._space.dim == 2:
            return
        missing = frame.depth is None or not (frame.depth > 0).any()
        self._events["depth_missing"] += missing
        if missing != bool(self._publisher.fault):
            self._publisher.fault = f"{self._what}: frames come without depth" if missing else ""
            _log.warning("%s: %s", self._what, "no depth" if missing else "depth is back")

    def _end_features(self) -> None:
        ended = self._tracker.reset()
        if self._stamp_ns is not None and len(ended):
            self._publisher.put(self._observer.ending(ended, self._stamp_ns))

    def _recover(self, error: InputError) -> None:
        """Reopen a lost device, or return when the process is stopped."""
        _log.warning("%s; trying again every %g s", error, _RETRY_S)
        self._publisher.fault = f"lost: {error}"
        self._end_features()
        self._camera.close()
        while not self._publisher.stop.wait(_RETRY_S):
            try:
                self._camera = open_frames(self._what, self._options.rate)
            except InputError:
                continue
            self._attach()
            self._publisher.fault = ""
            self._events["reconnects"] += 1
            _log.warning("%s: is back", self._what)
            break
        if self._publisher.stop.is_set():
            self._camera.close()
