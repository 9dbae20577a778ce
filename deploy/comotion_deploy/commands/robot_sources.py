"""``comotion source proprioception`` and ``workcell``: what a robot's joints say, and a simulated robot."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UserError
from ..network import Process
from ..options import argument, option, setting
from .played_sources import Timed

if TYPE_CHECKING:
    from comotion_sources.proprioception.joints import Reader

_WORKCELL = "workcell:"


class Proprioception(Process):
    """Publish the 6-DoF poses of a robot's links from its joint positions."""

    epilog = """
Examples:
  comotion source proprioception workcell:arm --name arm
  comotion source proprioception ur5.urdf --joints ur5 --link tool0 --base 0.4,0,0.8
  comotion source proprioception ur5.urdf --csv joints.csv --link tool0
  comotion source proprioception ur5.urdf --bag run1.mcap --topic /joint_states --link tool0
  comotion source proprioception ur5.urdf --ros /joint_states --ros-connect tcp/192.168.1.20:7447
"""
    name = "proprioception"

    model: str = argument(..., "MODEL", "URDF or MJCF file of the robot, or workcell:SCENE.")
    joints: str | None = option(None, "Follow the joint states NAME of the scene.", metavar="NAME")
    csv: Path | None = option(
        None, "Play a log: stamp_ns or time, then one column per joint.", metavar="FILE"
    )
    bag: Path | None = option(
        None, "Play sensor_msgs/JointState of a ROS 2 bag (MCAP or SQLite).", metavar="FILE"
    )
    ros: str | None = option(
        None, "Follow a topic of sensor_msgs/JointState over rmw_zenoh.", metavar="TOPIC"
    )
    topic: str | None = option(None, "Topic in the bag; needed if it has several.")
    ros_domain: int = option(0, "ROS domain id, for --ros.", env="ROS_DOMAIN_ID", min=0)
    ros_connect: str | None = option(
        None, "Router of the ROS network. Default: the scene's router.", metavar="ENDPOINT"
    )
    link: list[str] | None = option(
        None, "Link to publish; may be repeated. Default: all moving links, or the robot's."
    )
    base: str = option("0,0,0", "Pose of the robot base in the world (m).", metavar="X,Y,Z[,QX,QY,QZ,QW]")
    rate: float = setting(200.0, "Most instants per second.", min=1, max=1000)
    batch: float = option(0.02, "Seconds of instants packed in one batch.", min=0, max=1)
    encoder: float = option(9.5873799e-05, "Resolution of the rotary encoders, rad. Default: 16 bits.", min=0)
    linear_encoder: float = option(1e-5, "Resolution of the linear encoders, m.", min=0)
    speed: float = option(1.0, "Recorded seconds per second.", min=0.01)
    original_stamps: bool = option(False, "Keep the stamps of a log (serve with --clock event).")
    space: str = option("world", "Coordinate space of the poses.")

    def run(self) -> None:
        """Publish until stopped, or to the end of a log."""
        from comotion_sources.calibration.model import Extrinsics
        from comotion_sources.proprioception import process
        from comotion_sources.proprioception.kinematics import Encoders, Kinematics

        try:
            base = [float(part) for part in self.base.split(",")]
        except ValueError:
            base = []
        if len(base) not in (3, 7):
            raise UserError(f"--base {self.base}: expected X,Y,Z or X,Y,Z,QX,QY,QZ,QW")
        place = Extrinsics.from_quaternion(base[3:] or (0, 0, 0, 1), base[:3])
        loaded, links, truth, default_joints = _load(self.model, self.link)
        encoders = Encoders(angular=self.encoder, linear=self.linear_encoder)
        kinematics = Kinematics(loaded, links, place, encoders)
        reader = self._joint_reader(default_joints)
        self.call(process.run, kinematics, reader, span=self.batch, truth=truth, **self.where())

    def _joint_reader(self, default_joints: str | None) -> "Reader":
        """Open the input that is given, or the joint states of the workcell."""
        from functools import partial

        from comotion_schemas.transport import SessionSettings
        from comotion_sources.proprioception.joints import played, read_bag, read_csv, ros_topic, scene_joints

        inputs = {"--joints": self.joints, "--csv": self.csv, "--bag": self.bag, "--ros": self.ros}
        if all(value is None for value in inputs.values()):
            inputs["--joints"] = default_joints
        if sum(value is not None for value in inputs.values()) != 1:
            raise UserError(f"name one input: {', '.join(inputs)}")
        if self.ros is not None:
            settings = None if self.ros_connect is None else SessionSettings(connect=(self.ros_connect,))
            return partial(ros_topic, topic=self.ros, domain=self.ros_domain, settings=settings)
        log = self.csv or self.bag
        if log is None:
            return partial(scene_joints, name=str(inputs["--joints"]))
        if not log.exists():
            raise UserError(f"{log}: no such file")
        samples = read_csv(log) if log is self.csv else read_bag(log, self.topic)
        return partial(played, samples=samples, speed=self.speed, original_stamps=self.original_stamps)


def _load(
    model: str, links: list[str] | None
) -> tuple[Any, list[str] | None, dict[str, tuple[int, str]] | None, str | None]:
    """Return model, links, truth of the links and name of the default joint states."""
    from comotion_sources.proprioception.kinematics import load_model

    if not model.startswith(_WORKCELL):
        return load_model(Path(model)), links, None, None
    from comotion_sources.workcell import Scene

    cell = Scene(model.removeprefix(_WORKCELL))
    chosen = links or list(cell.robot)
    numbers = {name: cell.object_of(name) for name in chosen}
    truth = {name: (number, cell.objects.get(number, "")) for name, number in numbers.items()}
    return cell.model, chosen, truth, "workcell"


class Workcell(Timed, Process):
    """Publish the joint states of a simulated workcell, which its cameras follow."""

    epilog = """
Examples:
  comotion source workcell --list
  comotion source workcell truck   # publishes joint states; then, in other terminals:
  comotion source klt workcell:truck/a --name klt-a
  comotion source proprioception workcell:truck --name gripper
  comotion source workcell shelf --write-tum shelf-a --camera "a?size=320x240"
"""

    workcell_scene: str | None = argument(None, "SCENE", "A workcell scene of --list.")
    list_: bool = option(False, "List the scenes with their cameras and end.")
    rate: float = setting(200.0, "Joint states per second.", min=1, max=1000)
    seed: int = setting(0, "Seed of the timing (and of the cameras, if they have the same ?seed=).", min=0)
    write_tum: Path | None = option(
        None, "Write the frames of a camera as a TUM RGB-D folder instead, and end.", metavar="DIR"
    )
    camera: str = option("a", "The camera for --write-tum, with options after '?'.")
    name: str = setting(
        "workcell",
        "Name of the stream of joint states. With a certificate: its name.",
        env="COMOTION_SOURCE_NAME",
    )

    def run(self) -> None:
        """Publish until stopped."""
        from comotion_schemas.text import counted
        from comotion_sources.workcell import process
        from comotion_sources.workcell.camera import WorkcellCamera, parse, write_tum
        from comotion_sources.workcell.scene import Scene, scene_names

        if self.list_:
            for name in scene_names():
                scene = Scene(name)
                moving = ", ".join(scene.objects[number] for number in sorted(scene.objects) if number)
                print(f"{name:22} cameras {', '.join(scene.cameras)}; {scene.period:g} s; moving: {moving}")
            return
        if self.workcell_scene is None:
            raise UserError("which scene? 'comotion source workcell --list' names them")
        if self.write_tum is not None:
            spec = parse(f"{self.workcell_scene}/{self.camera}")
            spec = replace(spec, seed=self.seed or spec.seed, duration=self.duration or spec.duration)
            count = write_tum(WorkcellCamera(spec), self.write_tum)
            print(f"{counted(count, 'frame')} in {self.write_tum}")
            return
        self.call(process.run, Scene(self.workcell_scene, self.seed), **self.where())
