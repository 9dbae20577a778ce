"""Updates in the formats of other tools: URDF for simulators, and paths in the TUM format, as evo reads them.

In URDF the hypotheses of a space are links, and what connects them joints. Every link has the axes of the
space at the stamp of the update, and its origin where its joint is. Position 0 of every joint is that of the
update. What has no joint floats; what rests is fixed to the root, which is the space. A link has the extent
of its hypothesis, and a mass of 1 kg: masses cannot be seen.

A line of TUM is ``time x y z qx qy qz qw``, time in s: ``evo_ape tum truth.tum camera-<space>.tum -a``.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from contextlib import suppress
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np

from comotion_schemas import Box, Hypothesis, HypothesisUpdate, Joint, Pose
from comotion_schemas.errors import KnownError
from comotion_schemas.rigid import rotation, three

_MASS = 1.0
# m; least size of a link, so that its inertia is above zero.
_LEAST = 0.01
_KINDS = {"fixed", "prismatic", "revolute"}
# URDF requires limits of effort and velocity: none are known.
_UNLIMITED = "1000"


def to_urdf(update: HypothesisUpdate, space: str | None = None, name: str = "comotion") -> str:
    """Describe the hypotheses of a 3-D metric space as a tree of links and joints.

    Parameters
    ----------
    update
        With `joints`.
    space
        Name of the space; None: the only one in which hypotheses have a pose in 3-D.
    name
        Name of the robot.

    Returns
    -------
    str
        An XML document.

    Raises
    ------
    ValueError
        If there is no such space, or several where none is named.
    """
    posed = [h for h in update.hypotheses if h.pose is not None and len(h.centroid) == 3 and h.confirmed]
    spaces = sorted({h.space for h in posed})
    if space is None and len(spaces) > 1:
        raise KnownError(f"there are several spaces; choose one of {', '.join(spaces)}")
    if not spaces or (space is not None and space not in spaces):
        raise KnownError(f"no hypothesis has a pose in 3-D in {'the update' if space is None else space}")
    chosen = space or spaces[0]
    bodies = {h.id: h for h in posed if h.space == chosen}
    robot = ET.Element("robot", name=name)
    ET.SubElement(robot, "link", name=chosen)
    origins: dict[int | None, Sequence[float]] = {None: [0.0, 0.0, 0.0]}
    for parent, body, joint in _tree(bodies, update.joints):
        at = body.centroid if joint is None or joint.point is None else joint.point
        origins[body.id] = at
        _add_link(robot, body, at)
        above = chosen if parent is None else link_name(parent)
        _add_joint(robot, above, body, joint, np.subtract(at, origins[parent]).tolist())
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def link_name(hypothesis: int) -> str:
    """Name of the link of a hypothesis."""
    return f"hypothesis-{hypothesis}"


def _tree(
    bodies: dict[int, Hypothesis], joints: Sequence[Joint]
) -> list[tuple[int | None, Hypothesis, Joint | None]]:
    """(parent, body, joint) of every body, parents first; the surest joints where there is a choice."""
    usable = [j for j in joints if j.kind in _KINDS and j.parent in bodies and j.child in bodies]
    above: dict[int, Joint] = {}
    parents: dict[int, set[int]] = {number: set() for number in sorted(bodies)}
    for joint in sorted(usable, key=lambda j: (-j.confidence, j.parent, j.child)):
        if joint.child not in above:
            with suppress(CycleError):
                TopologicalSorter(parents | {joint.child: {joint.parent}}).prepare()
                above[joint.child], parents[joint.child] = joint, {joint.parent}
    return [
        (above[number].parent if number in above else None, bodies[number], above.get(number))
        for number in TopologicalSorter(parents).static_order()
    ]


def _add_joint(
    robot: ET.Element, parent: str, body: Hypothesis, joint: Joint | None, at: Sequence[float]
) -> None:
    rest = "fixed" if body.state == "static" else "floating"
    kind = rest if joint is None else joint.kind
    element = ET.SubElement(robot, "joint", name=f"joint-{body.id}", type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=link_name(body.id))
    ET.SubElement(element, "origin", xyz=_text(at), rpy="0 0 0")
    if joint is None or joint.axis is None:
        return
    ET.SubElement(element, "axis", xyz=_text(joint.axis))
    now = joint.position or 0.0
    ET.SubElement(
        element,
        "limit",
        lower=_number((joint.lower if joint.lower is not None else now) - now),
        upper=_number((joint.upper if joint.upper is not None else now) - now),
        effort=_UNLIMITED,
        velocity=_UNLIMITED,
    )


def _add_link(robot: ET.Element, body: Hypothesis, origin: Sequence[float]) -> None:
    link = ET.SubElement(robot, "link", name=link_name(body.id))
    box = body.box or Box(center=list(body.centroid), half=[_LEAST] * 3, rotation=[0.0, 0.0, 0.0, 1.0])
    size = [max(2 * half, _LEAST) for half in box.half]
    place = {
        "xyz": _text(np.subtract(box.center, origin).tolist()),
        "rpy": _text(rotation(box.rotation).as_euler("xyz").tolist()),
    }
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", place)
    ET.SubElement(inertial, "mass", value=_number(_MASS))
    moments = [_MASS / 12 * (sum(s**2 for s in size) - side**2) for side in size]
    ET.SubElement(
        inertial,
        "inertia",
        {name: _number(value) for name, value in zip(("ixx", "iyy", "izz"), moments, strict=True)}
        | {"ixy": "0", "ixz": "0", "iyz": "0"},
    )
    visual = ET.SubElement(link, "visual")
    ET.SubElement(visual, "origin", place)
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=_text(size))


def _text(values: Sequence[float]) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    return f"{value if math.isfinite(value) else 0.0:.9g}"


def save_paths(folder: Path, updates: Iterable[HypothesisUpdate]) -> list[Path]:
    """Write a file for each path to a folder, which is made; returns the files.

    ``camera-<space>`` is that of a frame that moves, ``hypothesis-<id>`` that of a body.

    Raises
    ------
    OSError
        If one cannot be written.
    """
    paths: dict[str, list[str]] = {}
    last_ns: int | None = None
    for update in updates:
        if update.stamp_ns == last_ns:
            continue
        last_ns = update.stamp_ns
        poses = [(f"camera-{space}", pose) for space, pose in update.frames.items()]
        bodies = (h for h in update.hypotheses if not h.absent)
        poses += [(f"hypothesis-{h.id}", h.pose) for h in bodies if h.pose is not None]
        for name, pose in poses:
            paths.setdefault(name, []).append(line(update.stamp_ns, pose))
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, lines in paths.items():
        file = folder / f"{name}.tum"
        file.write_text("\n".join([*lines, ""]))
        files.append(file)
    return files


def line(stamp_ns: int, pose: Pose) -> str:
    """Return the line of a pose; one in the plane is in z = 0."""
    values = (*three(pose.translation), *rotation(pose.rotation).as_quat())
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{seconds}.{rest:09d} " + " ".join(f"{value:.9g}" for value in values)
