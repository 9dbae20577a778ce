"""TUM RGB-D folders: read, and written by simulated cameras.

::

    rgb.txt   depth.txt    lines "time file"; time in seconds, file relative to the folder
    rgb/*.png depth/*.png  8-bit colour; 16-bit depth in 1/5000 m, 0 = missing
    camera.toml            ours, optional: calibration, names of the true objects
    objects.txt objects/*.png   ours, optional: true object + 1 of each pixel, 16-bit, 0 = unknown
"""

import logging
import tomllib
from collections.abc import Iterator, Mapping
from io import TextIOBase
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..calibration.files import Calibration, calibration_of, format_calibration
from ..calibration.model import Extrinsics, Intrinsics
from .files import DEFAULT_RATE, read_image, stamp_ns
from .types import CameraError, Frame

DEPTH_SCALE = 5000.0
ASSOCIATION_NS = 20_000_000
"""Longest time between an image and the depth that is taken for it."""

_CALIBRATION = "camera.toml"
_log = logging.getLogger(__name__)

Listing = list[tuple[int, Path]]


def is_tum_folder(folder: Path) -> bool:
    """Whether a folder says that it holds such a recording."""
    return (folder / "rgb.txt").is_file()


class TumFolder:
    """A TUM RGB-D folder; each image gets the depth nearest in time, within 20 ms.

    Frames come in the order of ``rgb.txt``, late and repeated ones included.

    Raises
    ------
    CameraError
        If a list is missing or malformed, or the calibration in it is.
    """

    live = False
    has_depth = True

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._images = _listing(folder, "rgb.txt")
        self._depths = _Nearest(_listing(folder, "depth.txt"))
        objects = folder / "objects.txt"
        self._truths = _Nearest(_listing(folder, "objects.txt") if objects.is_file() else [])
        if not self._images:
            raise CameraError(f"{folder / 'rgb.txt'}: lists no image")
        self.intrinsics, self.extrinsics, self.objects = _read_camera(folder / _CALIBRATION)
        gaps = np.diff([stamp for stamp, _ in self._images])
        gaps = gaps[gaps > 0]
        self.rate: float | None = float(1e9 / np.median(gaps)) if gaps.size else DEFAULT_RATE
        self.counters = {"unreadable": 0, "depth_missing": 0}
        self._closed = False

    def __iter__(self) -> Iterator[Frame]:
        for stamp, path in self._images:
            if self._closed:
                return
            image = read_image(path)
            if image is None:
                self.counters["unreadable"] += 1
                _log.warning("%s: no image that can be read; skipped", path)
                continue
            depth = self._depth(stamp, image.shape[:2])
            self.counters["depth_missing"] += depth is None
            yield Frame(stamp, image, depth, self._objects(stamp, image.shape[:2]))

    def close(self) -> None:
        """Let an iteration end at its next frame."""
        self._closed = True

    def _depth(self, stamp: int, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
        raw = _read_16_bit(self._depths.at(stamp), shape)
        return None if raw is None else np.asarray(raw / np.float32(DEPTH_SCALE), np.float32)

    def _objects(self, stamp: int, shape: tuple[int, ...]) -> NDArray[np.int32] | None:
        raw = _read_16_bit(self._truths.at(stamp), shape)
        return None if raw is None else raw.astype(np.int32) - 1


class _Nearest:
    """Finds the file nearest in time, None beyond 20 ms."""

    def __init__(self, listing: Listing) -> None:
        self._listing = sorted(listing)
        self._stamps = np.array([stamp for stamp, _ in self._listing], np.int64)

    def at(self, stamp: int) -> Path | None:
        if not self._listing:
            return None
        index = int(np.argmin(np.abs(self._stamps - stamp)))
        return self._listing[index][1] if abs(int(self._stamps[index]) - stamp) <= ASSOCIATION_NS else None


def _listing(folder: Path, name: str) -> Listing:
    path = folder / name
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text file"
        raise CameraError(f"{path}: {reason}") from None
    entries = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            time, file = line.split(maxsplit=1)
            entries.append((stamp_ns(time), folder / file.strip()))
        except ValueError:
            raise CameraError(f"{path}: line {number} is not 'time file'") from None
    return entries


def _read_16_bit(path: Path | None, shape: tuple[int, ...]) -> NDArray[np.uint16] | None:
    """Read a 16-bit image of that shape; anything else counts as missing."""
    if path is None or not path.is_file():
        return None
    raw = np.fromfile(path, np.uint8)
    image = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if raw.size else None
    if image is None or image.dtype != np.uint16 or image.shape != shape:
        return None
    return np.asarray(image, np.uint16)


def _read_camera(path: Path) -> tuple[Intrinsics | None, Extrinsics | None, Mapping[int, str]]:
    if not path.is_file():
        return None, None, {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        names = content.pop("objects", {})
        objects = {int(number): str(name) for number, name in names.items()}
        calibration = calibration_of(content) if content else Calibration()
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise CameraError(f"{path}: {' '.join(str(error).split())}") from None
    return calibration.intrinsics, calibration.extrinsics, objects


class TumWriter:
    """Writes frames as a TUM RGB-D folder; a context manager.

    Parameters
    ----------
    folder
        Made if need be; must not hold a recording yet.
    intrinsics, extrinsics, objects
        Written to ``camera.toml``, so that the folder can be used by itself.

    Raises
    ------
    CameraError
        If the folder holds a recording already.
    """

    def __init__(
        self,
        folder: Path,
        intrinsics: Intrinsics | None = None,
        extrinsics: Extrinsics | None = None,
        objects: Mapping[int, str] | None = None,
    ) -> None:
        if is_tum_folder(folder):
            raise CameraError(f"{folder}: holds a recording already")
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._lists: dict[str, TextIOBase] = {}
        for kind in ("rgb", "depth"):
            self._list(kind)
        _write_camera(folder / _CALIBRATION, intrinsics, extrinsics, objects or {})

    def write(self, frame: Frame) -> None:
        """Append a frame."""
        self._put("rgb", frame.stamp_ns, frame.image)
        if frame.depth is not None:
            units = np.rint(np.nan_to_num(frame.depth, nan=0.0) * DEPTH_SCALE)
            # What does not fit is beyond the sensor's range: missing.
            units[(units < 0) | (units > 65535)] = 0
            self._put("depth", frame.stamp_ns, units.astype(np.uint16))
        if frame.objects is not None:
            self._put("objects", frame.stamp_ns, (frame.objects + 1).astype(np.uint16))

    def close(self) -> None:
        """Finish the lists."""
        for file in self._lists.values():
            file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _list(self, kind: str) -> TextIOBase:
        if kind not in self._lists:
            (self._folder / kind).mkdir(exist_ok=True)
            self._lists[kind] = (self._folder / f"{kind}.txt").open("w", encoding="utf-8")
            self._lists[kind].write("# timestamp filename\n")
        return self._lists[kind]

    def _put(self, kind: str, stamp: int, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        time = f"{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d}"
        listing = self._list(kind)
        ok, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not ok:
            raise CameraError(f"{self._folder}: the {kind} image could not be encoded")
        (self._folder / kind / f"{time}.png").write_bytes(encoded.tobytes())
        listing.write(f"{time} {kind}/{time}.png\n")
        # Line by line, so that a recording that is cut short can be read up to there.
        listing.flush()


def _write_camera(
    path: Path,
    intrinsics: Intrinsics | None,
    extrinsics: Extrinsics | None,
    objects: Mapping[int, str],
) -> None:
    text = format_calibration(intrinsics, extrinsics)
    if objects:
        escaped = {k: v.replace("\\", "\\\\").replace('"', '\\"') for k, v in objects.items()}
        text += "\n[objects]\n" + "".join(f'{number} = "{name}"\n' for number, name in escaped.items())
    if text:
        path.write_text(text, encoding="utf-8")
