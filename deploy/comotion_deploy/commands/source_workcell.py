"""``comotion source workcell``: publishes the joint states of a simulated workcell."""

from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from ..options import Process, argument, option, setting
from .source_options import Timed


@dataclass(kw_only=True)
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
        from comotion_sources.workcell import process
        from comotion_sources.workcell.scene import Scene

        if self.list_:
            _print_scenes()
            return
        if self.workcell_scene is None:
            raise UserError("which scene? 'comotion source workcell --list' names them")
        if self.write_tum is not None:
            _write(self.workcell_scene, self.camera, self.seed, self.duration, self.write_tum)
            return
        process.run(
            Scene.named(self.workcell_scene, self.seed),
            rate=self.rate,
            duration=self.duration,
            name=self.name,
            **self.where(),
        )


def _print_scenes() -> None:
    from comotion_sources.workcell.scene import Scene, scene_names

    for name in scene_names():
        scene = Scene.named(name)
        moving = ", ".join(scene.objects[number] for number in sorted(scene.objects) if number)
        print(f"{name:22} cameras {', '.join(scene.cameras)}; {scene.period:g} s; moving: {moving}")


def _write(scene: str, camera: str, seed: int, duration: float | None, folder: Path) -> None:
    from dataclasses import replace

    from comotion_schemas.text import counted
    from comotion_sources.workcell.camera import WorkcellCamera, parse, write_tum

    spec = parse(f"{scene}/{camera}")
    spec = replace(spec, seed=seed or spec.seed, duration=duration or spec.duration)
    count = write_tum(WorkcellCamera(spec), folder)
    print(f"{counted(count, 'frame')} in {folder}")
