"""Runs the scenes of the figures, each one once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from comotion import FusionConfig
from comotion_sources import simulator
from comotion_sources.simulator import SceneSpec

from ..processes import Progress, quiet
from .runs import SceneRuns, ViewRequest, run_seed


@dataclass(frozen=True)
class Options:
    """Options of all figures.

    Attributes
    ----------
    seeds
        Seeds of the simulated scenes.
    workcell_seeds
        Seeds of the workcell.
    quick
        Small images and a short run of the workcell.
    cache
        Folder that keeps tracked features; None: none.
    default
        Parameters of the default method.
    """

    seeds: Sequence[int] = tuple(range(5))
    workcell_seeds: Sequence[int] = (0, 1)
    quick: bool = False
    cache: Path | None = None
    default: FusionConfig = field(default_factory=FusionConfig)


class Study:
    """Runs scenes through the core; a run that two figures share is done once.

    Parameters
    ----------
    options
        Options.
    note
        Called with the name of the next run.
    """

    def __init__(self, options: Options, note: Progress = quiet) -> None:
        self.options = options
        self.note = note
        self._takes: dict[Any, SceneRuns] = {}

    def simulated(
        self, scene: str, config: FusionConfig, *, period: float, close: ViewRequest | None = None
    ) -> SceneRuns:
        """Run all seeds of a simulated scene."""
        close = close or ViewRequest()
        spec = spec_of(scene)

        def make() -> SceneRuns:
            runs = []
            for seed in self.options.seeds:
                self.note(f"{scene}, {describe(config)}, seed {seed}")
                messages = list(simulator.batches(simulator.simulate(spec, seed=seed)))
                runs.append(run_seed(messages, config, period, close))
            return SceneRuns(runs)

        return self.once((scene, config.model_dump_json(), period, close), make)

    def both(
        self, scene: str, config: FusionConfig, *, period: float, close: ViewRequest
    ) -> tuple[SceneRuns, SceneRuns]:
        """Run all seeds with parameters of the thesis method, and with the default method."""
        first, second = (
            self.simulated(scene, method, period=period, close=close)
            for method in (config, self.options.default)
        )
        return first, second

    def once(self, key: Any, make: Callable[[], SceneRuns]) -> SceneRuns:
        """SceneRuns from memory, or make and keep."""
        if key not in self._takes:
            self._takes[key] = make()
        return self._takes[key]


def spec_of(scene: str) -> SceneSpec:
    """A scene that ships with the simulator."""
    return simulator.load_scene(scene)


def describe(config: FusionConfig) -> str:
    """Name a set of parameters in a few words."""
    if config.method == "comotion":
        return "default method"
    weights = "equal weights" if config.thesis.v_move is None else f"v = {config.thesis.v_move:g}"
    return f"thesis method, σ = {config.thesis.sigma_switch:g}, {weights}"
