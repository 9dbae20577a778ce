"""Reads and writes TUM RGB-D folders.

The layout::

    rgb.txt   depth.txt     lines "time file": time in seconds, file relative to the folder
    rgb/*.png depth/*.png   8-bit colour; 16-bit depth in 1/5000 m, 0 = missing
    groundtruth.txt         lines "time tx ty tz qx qy qz qw": the camera (optical axes) in the world

Optional files that the TUM format does not define::

    camera_info.yaml        intrinsics, as ROS writes them
    objects.txt             lines "number name": the true objects
    objects/*.png           named like those of rgb/: 16-bit, number of the object + 1, 0 = unknown
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

from ..calibration.files import format_camera_info, read_calibration
from ..calibration.model import Extrinsics, Intrinsics
from ..poses import parsed, stamp_ns, trajectory
from .files import DEFAULT_RATE, RecordedCamera, read_image
from .types import Frame

DEPTH_SCALE = 5000.0
ASSOCIATION_NS = 20_000_000
"""Longest time between an image and its depth image; the default of the TUM associate tool."""
_MOVED = 1e-3  # m, or parts of a unit quaternion: a camera that moves by more is not fixed
_HEADS = {"rgb": "time image", "depth": "time depth", "groundtruth": "time tx ty tz qx qy qz qw"}

Listing = list[tuple[int, Path]]


class TumFolder(RecordedCamera):
    """A TUM RGB-D folder; each image gets the depth image nearest in time, within 20 ms.

    Frames come in the order of ``rgb.txt``, including late and repeated ones. The intrinsics are
    those of ``camera_info.yaml``. The extrinsics are those of ``groundtruth.txt`` if the camera does
    not move.

    Raises
    ------
    InputError
        If a list or calibration file is missing or malformed.
    """

    has_depth = True

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._listed = _listing(folder, "rgb.txt")
        self._depths = sorted(_listing(folder, "depth.txt"))
        self._depth_stamps = np.array([stamp for stamp, _ in self._depths], np.int64)
        if not self._listed:
            raise InputError(f"{folder / 'rgb.txt'}: lists no image")
        gaps = np.diff([stamp for stamp, _ in self._listed])
        gaps = gaps[gaps > 0]
        super().__init__(float(1e9 / np.median(gaps)) if gaps.size else DEFAULT_RATE, len(self._listed))
        self.counters["depth_missing"] = 0
        info = folder / "camera_info.yaml"
        self.intrinsics = read_calibration(info).intrinsics if info.is_file() else None
        self.extrinsics = _read_still_pose(folder / "groundtruth.txt")
        self.objects = _read_names(folder / "objects.txt")

    def _read(self) -> Iterator[Frame]:
        for number, path, image in self._images(path for _, path in self._listed):
            stamp = self._listed[number][0]
            depth = self._depth(stamp, image.shape[:2])
            self.counters["depth_missing"] += depth is None
            raw = _read_16_bit(self._folder / "objects" / f"{path.stem}.png", image.shape[:2])
            yield Frame(stamp, image, depth, None if raw is None else raw.astype(np.int32) - 1)

    def _depth(self, stamp: int, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
        distances = np.abs(self._depth_stamps - stamp)
        if not distances.size or distances.min() > ASSOCIATION_NS:
            return None
        raw = _read_16_bit(self._depths[int(np.argmin(distances))][1], shape)
        return None if raw is None else np.asarray(raw / np.float32(DEPTH_SCALE), np.float32)


def _listing(folder: Path, name: str) -> Listing:
    def entry(line: str) -> tuple[int, Path]:
        time, file = line.split(maxsplit=1)
        return stamp_ns(time), folder / file

    return list(parsed(folder / name, "time file", entry))


def _read_names(path: Path) -> dict[int, str]:
    def entry(line: str) -> tuple[int, str]:
        number, name = line.split(" ", 1)
        return int(number), name

    return dict(parsed(path, "number name", entry)) if path.is_file() else {}


def _read_still_pose(path: Path) -> Extrinsics | None:
    """Read the pose of a fixed camera; None if the camera moves."""
    first: Extrinsics | None = None
    for _, pose in trajectory(path) if path.is_file() else ():
        first = first or pose
        moved = np.abs(pose.translation - first.translation).max()
        if max(moved, np.abs(pose.quaternion - first.quaternion).max()) > _MOVED:
            return None
    return first


def _read_16_bit(path: Path, shape: tuple[int, ...]) -> NDArray[np.uint16] | None:
    """Read a 16-bit image of the given shape; None for anything else."""
    image = read_image(path, cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.shape != shape:
        return None
    return image


def write_folder(
    folder: Path,
    frames: Iterable[tuple[Frame, Extrinsics | None]],
    intrinsics: Intrinsics | None = None,
    objects: Mapping[int, str] | None = None,
) -> int:
    """Write frames as a TUM RGB-D folder; returns their number.

    The `folder` is made if it does not exist, and must be empty; `frames` are with the pose of the camera, if
    it is known, and keep their stamps to the microsecond; `intrinsics` and `objects` go into the optional
    files.

    Raises
    ------
    InputError
        If the folder exists and is not empty.
    OSError
        If it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists already")
    for kind in ("rgb", "depth", "objects"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    names = "".join(f"{number} {name}\n" for number, name in (objects or {}).items())
    texts = {f"{kind}.txt": f"# {head}\n" for kind, head in _HEADS.items()} | {"objects.txt": names}
    if intrinsics is not None:
        texts["camera_info.yaml"] = format_camera_info(intrinsics)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    count = 0
    for count, (frame, pose) in enumerate(frames, 1):  # noqa: B007 - returned
        _write(folder, frame, pose)
    return count


def _write(folder: Path, frame: Frame, pose: Extrinsics | None) -> None:
    micros = frame.stamp_ns // 1000
    time = f"{micros // 1_000_000}.{micros % 1_000_000:06d}"
    images: dict[str, NDArray[Any]] = {"rgb": frame.image}
    if frame.depth is not None:
        units = np.rint(np.nan_to_num(frame.depth, nan=0.0) * DEPTH_SCALE)
        # A depth beyond 16 bits (13 m) is out of range: missing.
        units[(units < 0) | (units > 65535)] = 0
        images["depth"] = units.astype(np.uint16)
    if frame.objects is not None:
        images["objects"] = (frame.objects + 1).astype(np.uint16)
    lines: dict[str, str] = {kind: f"{kind}/{time}.png" for kind in ("rgb", "depth") if kind in images}
    if pose is not None:
        lines["groundtruth"] = " ".join(f"{value:.9f}" for value in (*pose.translation, *pose.quaternion))
    for kind, image in images.items():
        ok, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not ok:
            raise InputError(f"{folder / kind / time}.png: the image could not be encoded")
        (folder / kind / f"{time}.png").write_bytes(encoded.tobytes())
    # Line by line: a recording that is cut short can be read up to that point.
    for kind, line in lines.items():
        with (folder / f"{kind}.txt").open("a", encoding="utf-8") as listing:
            listing.write(f"{time} {line}\n")
