"""``comotion source simulator``: publishes a simulated scene with its truth."""

from dataclasses import dataclass
from typing import Literal

from ..errors import UserError
from ..options import argument, option, setting
from .source_options import Played


@dataclass(kw_only=True)
class Simulator(Played):
    """Publish a simulated scene, with its truth, as one source or several."""

    epilog = """
Examples:
  comotion source simulator --list
  comotion source simulator fig4_4 --loop
  comotion source simulator fig4_4 --rate 15,30,100   # three sources in one process
  comotion source simulator fig4_4 --rate 30 --part 2/3 --start-at aligned --loop   # one of three processes
  comotion source simulator my_scene.toml --seed 7 --noise 2 --publish-sigma
"""

    simulated: str | None = argument(None, "SCENE", "A scene of --list, or a TOML file.")
    list_: bool = option(False, "List the scenes of the package and end.")
    split: Literal["features", "objects"] = setting("features", "How several sources divide the scene.")
    seed: int = setting(0, "Seed of the random numbers.", min=0)
    noise: float = setting(1.0, "Factor on the noise.", min=0)
    time_scale: float = setting(1.0, "2 plays twice as fast.")
    publish_sigma: bool = setting(False, "Publish the true noise.")

    def run(self) -> None:
        """Publish until stopped, or to the end of the scene."""
        from comotion_sources import simulator
        from comotion_sources.replay import play_streams
        from comotion_sources.schedule import Schedule, parse_start

        if self.list_:
            _print_scenes()
            return
        if self.simulated is None:
            raise UserError("which scene? see 'comotion source simulator --list'")
        simulations = simulator.simulate(
            simulator.load_scene(self.simulated),
            part=self.chosen_part(),
            rates=self.rates(),
            seed=self.seed,
            noise=self.noise,
            time_scale=self.time_scale,
            split=self.split,
        )
        play_streams(
            simulator.streams(simulations, self.name),
            self.taken(Schedule, start_at=parse_start(self.start_at)),
            message=f"simulates {simulations[0].spec.title}",
            publish_sigma=self.publish_sigma,
            **self.where(),
        )


def _print_scenes() -> None:
    from comotion_sources import simulator

    for name in simulator.scene_names():
        spec = simulator.load_scene(name)
        rates = ", ".join(f"{rate:g}" for rate in spec.rates)
        print(f"{name:<12} {spec.dim}-D {spec.duration:>6g} s  {rates:>11} Hz  {spec.title}")
