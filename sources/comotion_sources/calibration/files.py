"""Reads and writes calibration files: comotion (TOML), OpenCV and ROS camera_info (YAML).

The comotion format::

    [intrinsics]
    width = 640
    height = 480
    fx = 525.0
    fy = 525.0
    cx = 319.5
    cy = 239.5
    distortion = [0.0, 0.0, 0.0, 0.0, 0.0]   # k1 k2 p1 p2 k3 ..., optional

    [extrinsics]                # camera (optical axes) to `frame`, optional
    frame = "world"
    translation = [0.0, 0.0, 1.2]            # m
    quaternion = [0.0, 0.0, 0.0, 1.0]        # x y z w
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from comotion_schemas.errors import InputError, KnownError, describe

from ..bounded import parse_toml, read_text
from .model import Extrinsics, Intrinsics

_MAX_BYTES = 64_000
"""A larger file is not a calibration, and parsing it as YAML would take seconds."""
# Aliases make small files large, and deep ones take seconds to parse.
_BOMB = re.compile(r"(^|[\s\[{,:-])[&*]\S|[\[{]([^\[{\]}]*[\[{]){20}|([-?] +){20}", re.MULTILINE)
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "Distortion_Coefficients", "D", "d")
_WIDTH = ("image_width", "image_Width", "width")
_HEIGHT = ("image_height", "image_Height", "height")
_ROS_MODELS = ("plumb_bob", "rational_polynomial")


@dataclass(frozen=True)
class Calibration:
    """Content of a calibration file; a part that is not in the file is None."""

    intrinsics: Intrinsics | None = None
    extrinsics: Extrinsics | None = None


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file: comotion ``.toml``, or OpenCV or ROS ``.yaml``/``.yml``.

    Raises
    ------
    InputError
        If the file cannot be read or has another format.
    """
    try:
        text = read_text(path, _MAX_BYTES)
    except InputError as error:
        raise InputError(f"{error}, so not a calibration") from None
    try:
        return _from_toml(text) if path.suffix.lower() == ".toml" else _from_yaml(text)
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error)}") from None
    except (ValueError, TypeError, OverflowError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{path}: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"not valid YAML: {error.problem} in line {error.problem_mark.line + 1}"
    return " ".join(str(error).split())[:300] or type(error).__name__


_INTRINSICS = TypeAdapter(Intrinsics)


class _ExtrinsicsTable(BaseModel):
    model_config = ConfigDict(extra="forbid")

    frame: str = "world"
    translation: list[float]
    quaternion: list[float]


class _File(BaseModel):
    """A comotion TOML file; other tables belong to somebody else."""

    intrinsics: Intrinsics | None = None
    extrinsics: _ExtrinsicsTable | None = None


def _from_toml(text: str) -> Calibration:
    file = _File.model_validate(parse_toml(text))
    outer = file.extrinsics
    if file.intrinsics is None and outer is None:
        raise KnownError("neither [intrinsics] nor [extrinsics]")
    return Calibration(
        file.intrinsics,
        None
        if outer is None
        else Extrinsics.from_quaternion(outer.quaternion, outer.translation, outer.frame),
    )


def _from_yaml(text: str) -> Calibration:
    # OpenCV files start with "%YAML:1.0", which is not a valid YAML directive, and have a tag of their own.
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%YAML"))
    if _BOMB.search(body):
        raise KnownError("not valid YAML: an alias or deep nesting, which no calibration needs")
    content = yaml.safe_load(body.replace("!!opencv-matrix", ""))
    if not isinstance(content, dict):
        raise KnownError("not a map of names and values, so not a calibration")
    matrix = _numbers(_first(content, _MATRIX, "camera matrix"))
    model = content.get("distortion_model") or _ROS_MODELS[0]
    if model not in _ROS_MODELS:
        raise KnownError(f"distortion model {model!r} is not one of {', '.join(_ROS_MODELS)}")
    if len(matrix) != 9:
        raise KnownError(f"the camera matrix has {len(matrix)} numbers instead of 9")
    table = {
        "width": _first(content, _WIDTH, "image width"),
        "height": _first(content, _HEIGHT, "image height"),
        "distortion": next((_numbers(content[name]) for name in _DISTORTION if name in content), []),
    }
    pinhole = dict(zip(("fx", "cx", "fy", "cy"), (matrix[k] for k in (0, 2, 4, 5)), strict=True))
    return Calibration(_INTRINSICS.validate_python(table | pinhole))


def _first(content: Mapping[str, Any], names: tuple[str, ...], what: str) -> Any:
    for name in names:
        if name in content:
            return content[name]
    raise KnownError(f"no {what} ({', '.join(names[:3])} ...): neither an OpenCV nor a ROS calibration")


def _numbers(value: Any) -> list[float]:
    """The numbers of an OpenCV or ROS matrix (its ``data``) or of a list, of rows or plain."""
    data = value.get("data") if isinstance(value, dict) else value
    if not isinstance(data, list):
        raise KnownError("a matrix is neither a list of numbers nor a map with a list 'data'")
    # YAML 1.1 parses 1e-5 as a string; float() gives the number that ROS and OpenCV wrote.
    return [float(entry) for row in data for entry in (row if isinstance(row, list) else [row])]


def format_calibration(intrinsics: Intrinsics | None, extrinsics: Extrinsics | None) -> str:
    """Format a comotion TOML file; a part that is None is left out."""
    tables: dict[str, dict[str, Any]] = {}
    if intrinsics is not None:
        sizes = {"width": intrinsics.width, "height": intrinsics.height}
        pinhole = {name: float(getattr(intrinsics, name)) for name in ("fx", "fy", "cx", "cy")}
        tables["[intrinsics]"] = sizes | pinhole | {"distortion": intrinsics.distortion.tolist()}
    if extrinsics is not None:
        places = {name: getattr(extrinsics, name).tolist() for name in ("translation", "quaternion")}
        tables["[extrinsics]  # camera (optical axes) to frame: m, and x, y, z, w"] = {
            "frame": extrinsics.frame
        } | places
    # Numbers, lists and texts of JSON are those of TOML.
    return "\n".join(
        "\n".join(
            [
                head,
                *(f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in table.items()),
                "",
            ]
        )
        for head, table in tables.items()
    )


def format_camera_info(camera: Intrinsics) -> str:
    """Format intrinsics as ROS camera_info YAML."""
    # ROS writes 5 zeros for a camera without distortion; more than 5 belong to its rational model.
    coefficients = camera.distortion if camera.distortion.size else np.zeros(5)
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "distortion_model": _ROS_MODELS[coefficients.size > 5],
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
        "distortion_coefficients": {"rows": 1, "cols": coefficients.size, "data": coefficients.tolist()},
    }
    return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
