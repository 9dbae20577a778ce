"""Loads a robot from an MJCF or URDF file, as far as kinematics needs it."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from comotion_schemas.errors import InputError

from ..workcell.extra import require_mujoco

_MAX_BYTES = 16_000_000


def load_model(path: Path) -> Any:
    """Load an ``mjModel`` from an MJCF or URDF file.

    Meshes of a URDF are removed: kinematics does not need them, and their paths are often wrong. Links
    on fixed joints, such as tool frames, are kept.

    Raises
    ------
    InputError
        If the file is neither, or MuJoCo is not installed; the message is one line.
    """
    mujoco = require_mujoco()
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path}: more than {_MAX_BYTES} bytes")
        root = ET.parse(path).getroot()  # noqa: S314 - a file the user names; expat limits expansion
        if root.tag == "robot":
            return mujoco.MjModel.from_xml_string(_kinematics_only(root))
        return mujoco.MjModel.from_xml_path(str(path))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except RecursionError:
        raise InputError(f"{path}: its elements are nested too deeply") from None
    except InputError:
        raise
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None


def _kinematics_only(robot: ET.Element) -> str:
    for link in robot.iter("link"):
        for tag in ("visual", "collision", "inertial"):
            for element in link.findall(tag):
                link.remove(element)
    for old in robot.findall("mujoco"):
        robot.remove(old)
    extension = ET.SubElement(robot, "mujoco")
    # MuJoCo refuses moving links without mass; the value does not affect kinematics.
    ET.SubElement(
        extension, "compiler", fusestatic="false", boundmass="1", boundinertia="1", balanceinertia="true"
    )
    return ET.tostring(robot, encoding="unicode")
