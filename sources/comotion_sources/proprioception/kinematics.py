"""Forward kinematics of a robot in an MJCF or URDF file: poses of chosen links with their noise."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics
from ..workcell.scene import couplings, require_mujoco
from .joints import JointSample, Vector

_MAX_BYTES = 16_000_000
Vectors = NDArray[np.float64]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoders:
    """Resolution of the joint encoders, and the noise that they do not measure."""

    angular: float = 2 * np.pi / 2**16  # rad per count (default: 16 bits per turn)
    linear: float = 1e-5  # m per count
    # m; least one-sigma noise of a link, from backlash, compliance and calibration of the robot.
    floor: float = 1e-4


class LinkPoses(NamedTuple):
    """Poses of the chosen links.

    `positions` float64 [L, 3] in metres; `quaternions` float64 [L, 4] (x, y, z, w); `sigma` float64 [L],
    isotropic one-sigma noise of a position in metres.
    """

    positions: Vectors
    quaternions: Vectors
    sigma: Vector


class Kinematics:
    """Computes the poses of links of one robot.

    Parameters
    ----------
    model
        An ``mjModel`` (see :func:`load_model`).
    links
        Bodies to report; None: every link that a joint moves.
    base
        Transformation from the model's world frame to that of the scene; None: identity.
    encoders
        Encoder resolutions, for the noise.

    Attributes
    ----------
    links
        Names of the links, in the order of the poses.
    joints
        Names of the joints that move the links: a sample must contain them. Coupled joints are
        computed from their driving joint.

    Raises
    ------
    InputError
        If a link does not exist, no link moves, or a joint has more than one degree of freedom.
    """

    def __init__(
        self,
        model: Any,
        links: Sequence[str] | None = None,
        base: Extrinsics | None = None,
        encoders: Encoders | None = None,
    ) -> None:
        self._mujoco = require_mujoco()
        self._model, self._data = model, self._mujoco.MjData(model)
        self._base = base or Extrinsics()
        self._encoders = encoders or Encoders()
        names = [model.body(i).name for i in range(model.nbody)]
        self.links = tuple(links) if links else tuple(n for i, n in enumerate(names) if model.body_jntnum[i])
        if not self.links:
            raise InputError("the model has no link that a joint moves")
        for link in self.links:
            if link not in names:
                raise InputError(f"no link {link!r}; one of {', '.join(n for n in names[1:] if n)}")
        self._bodies = [names.index(link) for link in self.links]
        self._couplings = couplings(model)
        self._needed = self._find_joints()
        self.joints = tuple(model.joint(i).name for i in self._needed)
        hinge = int(self._mujoco.mjtJoint.mjJNT_HINGE)
        steps = np.where(model.jnt_type[self._needed] == hinge, self._encoders.angular, self._encoders.linear)
        # One sigma of a rounding error, by degree of freedom.
        self._counts = np.zeros(model.nv)
        self._counts[model.jnt_dofadr[self._needed]] = steps / np.sqrt(12.0)

    def poses(self, sample: JointSample) -> LinkPoses:
        """Compute the poses of the links for a joint sample; other joints in it are ignored.

        Raises
        ------
        InputError
            If one of :attr:`joints` is missing.
        """
        self._place(sample)
        places = self._data.xpos[self._bodies]
        rotations = Rotation.from_quat(self._data.xquat[self._bodies][:, [1, 2, 3, 0]])
        turned = Rotation.from_matrix(self._base.rotation) * rotations
        return LinkPoses(self._base.apply(places), turned.as_quat(canonical=True), self._sigma())

    def _place(self, sample: JointSample) -> None:
        positions: Mapping[str, float] = dict(zip(sample.names, sample.positions.tolist(), strict=True))
        for index, joint in zip(self._needed, self.joints, strict=True):
            if joint not in positions:
                raise InputError(f"no position of joint {joint!r}")
            self._data.qpos[self._model.jnt_qposadr[index]] = positions[joint]
        for target, driver, polynomial in self._couplings:
            value = polynomial(self._data.qpos[self._model.jnt_qposadr[driver]])
            self._data.qpos[self._model.jnt_qposadr[target]] = value
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)  # the Jacobian needs it

    def _sigma(self) -> Vector:
        """Encoder noise propagated by the Jacobian; isotropic: root of the mean of the three variances."""
        sigma = np.empty(len(self._bodies))
        jacobian = np.zeros((3, self._model.nv))
        for row, body in enumerate(self._bodies):
            self._mujoco.mj_jacBody(self._model, self._data, jacobian, None, body)
            for target, driver, polynomial in self._couplings:
                slope = polynomial.deriv()(self._data.qpos[self._model.jnt_qposadr[driver]])
                to, of = self._model.jnt_dofadr[target], self._model.jnt_dofadr[driver]
                jacobian[:, of] += slope * jacobian[:, to]
                jacobian[:, to] = 0.0
            variance = ((jacobian * self._counts) ** 2).sum() / 3.0
            sigma[row] = np.hypot(np.sqrt(variance), self._encoders.floor)
        return sigma

    def _find_joints(self) -> list[int]:
        """Indices of the joints between the world and the links, coupled ones replaced by their driver."""
        model, carriers = self._model, set[int]()
        for link in self._bodies:
            body = link
            while body:
                carriers.add(body)
                body = int(model.body_parentid[body])
        drivers = {target: driver for target, driver, _ in self._couplings}
        joints = [joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in carriers]
        needed = sorted({drivers.get(joint, joint) for joint in joints})
        single = (int(self._mujoco.mjtJoint.mjJNT_HINGE), int(self._mujoco.mjtJoint.mjJNT_SLIDE))
        for joint in needed:
            if int(model.jnt_type[joint]) not in single:
                name = model.joint(joint).name
                raise InputError(f"joint {name!r} is neither a hinge nor a slide")
        return needed
