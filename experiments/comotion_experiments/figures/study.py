"""What figures are, and the scenes that they are drawn from, each one run once."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from comotion import FusionConfig
from comotion_sources.simulator import batches, load_scene, simulate

from ..inputs import Message
from ..study import Progress, quiet
from .runs import SceneRuns, ViewRequest, run_seed

DEFAULT = "default method"


@dataclass(frozen=True)
class Options:
    """Options of all figures."""

    seeds: Sequence[int] = tuple(range(5))  # of the simulated scenes
    workcell_seeds: Sequence[int] = (0, 1)
    quick: bool = False  # small images and a short run of the workcell
    cache: Path | None = None  # folder that keeps tracked features; None: none
    default: FusionConfig = field(default_factory=FusionConfig)  # parameters of the default method


@dataclass(frozen=True)
class Simulated:
    """A simulated scene of some figures, and how it is run."""

    scene: str  # one that ships with the simulator
    configs: Mapping[str, FusionConfig]  # parameters of the thesis method, by label
    period: float  # s between updates
    close: ViewRequest = field(default_factory=ViewRequest)  # the requested views


class Study:
    """Runs scenes through the core; a run that two figures share is done once.

    `note` is called with the name of the next run.
    """

    def __init__(self, options: Options, note: Progress = quiet) -> None:
        self.options = options
        self.note = note
        self._takes: dict[Any, SceneRuns] = {}

    def simulated(self, how: Simulated) -> dict[str, SceneRuns]:
        """Run all seeds of a simulated scene, as :meth:`takes`."""
        spec = load_scene(how.scene)
        return self.takes(how, lambda seed: list(batches(simulate(spec, seed=seed))), self.options.seeds)

    def takes(
        self, how: Simulated, messages: Callable[[int], list[Message]], seeds: Sequence[int]
    ) -> dict[str, SceneRuns]:
        """Run the messages of all seeds with each of the parameters, by label; the default method last."""
        takes = {}
        for label, config in {**how.configs, DEFAULT: self.options.default}.items():
            key = (how.scene, config.model_dump_json(), how.period, how.close)
            if key not in self._takes:
                runs = []
                for seed in seeds:
                    given = messages(seed)
                    self.note(f"{how.scene}, {describe(config)}, seed {seed}")
                    runs.append(run_seed(given, config, how.period, how.close))
                self._takes[key] = SceneRuns(runs)
            takes[label] = self._takes[key]
        return takes


def alone(config: FusionConfig) -> dict[str, FusionConfig]:
    """One set of parameters of the thesis method, by its description."""
    return {describe(config): config}


def describe(config: FusionConfig) -> str:
    """Name a set of parameters in a few words."""
    if config.method == "comotion":
        return DEFAULT
    weights = "equal weights" if config.thesis.v_move is None else f"v = {config.thesis.v_move:g}"
    return f"thesis method, σ = {config.thesis.sigma_switch:g}, {weights}"


@dataclass(frozen=True)
class Row:
    """One number, or claim, of the thesis beside what both methods give here."""

    quantity: str
    printed: str
    thesis: str
    default: str


@dataclass(frozen=True)
class Drawn:
    """A drawn figure of matplotlib."""

    figure: Any
    rows: Sequence[Row]  # numbers beside those of the thesis
    parameters: Mapping[str, str]  # what it was made with, by name
    curves: Mapping[str, SceneRuns] = field(default_factory=dict)  # what is drawn as a curve, by its label


@dataclass(frozen=True)
class Figure:
    """A figure of the thesis by its number there, e.g. ``4.4``."""

    name: str
    title: str  # one line
    shows: str  # what is to be seen, and what the thesis says about it
    draw: Callable[[Study], Drawn]  # runs what is needed, and draws
    workcell: bool = False  # whether it needs the workcell (extra ``sim3d``)

    @property
    def anchor(self) -> str:
        """Its place in the page."""
        return f"fig{self.name.replace('.', '_')}"

    @property
    def file(self) -> str:
        """Name of its picture."""
        return f"{self.anchor}.png"
