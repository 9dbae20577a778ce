"""What figures are, the scenes that they are drawn from, each run once, and all that comes of them."""

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
    """Runs scenes through the core, each once, and draws figures into a folder, which it makes.

    `note` is called with the name of the next run; `made` are the figures with what came of drawing them.
    """

    def __init__(self, options: Options, out: Path, note: Progress = quiet) -> None:
        self.options, self.out = options, out
        self.made: list[tuple[Figure, Drawn]] = []
        self.left_out: list[Figure] = []
        self._progress, self._place = note, ""
        self._takes: dict[Any, SceneRuns] = {}

    def draw(self, figures: Sequence["Figure"], *, workcell: bool = True) -> None:
        """Draw figures in order; without the workcell (MuJoCo) those of it are left out."""
        self.out.mkdir(parents=True, exist_ok=True)
        self.left_out = [figure for figure in figures if figure.workcell and not workcell]
        chosen = [figure for figure in figures if figure not in self.left_out]
        for number, figure in enumerate(chosen, 1):
            self._place = f"[{number}/{len(chosen)}] figure {figure.name}"
            self._progress(self._place)
            drawn = figure.draw(self)
            drawn.figure.savefig(self.out / figure.file)
            self.made.append((figure, drawn))

    def note(self, what: str) -> None:
        """Say what runs next for the figure that is being drawn."""
        self._progress(f"{self._place}: {what}")

    def as_json(self) -> dict[str, Any]:
        """Everything, for JSON; a curve has seconds `t`, and `mean` and `std` of NMI over the seeds."""
        options = self.options
        return {
            "seeds": options.seeds,
            "workcell_seeds": options.workcell_seeds,
            "quick": options.quick,
            "default_method": options.default.model_dump(mode="json"),
            "left_out": [figure.name for figure in self.left_out],
            "figures": {
                figure.name: {
                    "title": figure.title,
                    "picture": figure.file,
                    "numbers": drawn.rows,
                    "parameters": drawn.parameters,
                    "curves": {label: take.as_json() for label, take in drawn.curves.items()},
                }
                for figure, drawn in self.made
            },
        }

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
