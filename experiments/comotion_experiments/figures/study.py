"""What figures are, the scenes that they are drawn from, each run once, and all that comes of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_schemas import UNDETERMINED
from comotion_sources.simulator import batches, load_scene, simulate

from ..inputs import Message
from ..study import Progress, quiet
from ..tables import spread
from ..trace import rightly_assigned
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


def count(values: Any) -> str:
    """Mean and, where seeds differ, standard deviation of one number per seed."""
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if len(finite) and finite.std() > 0:
        return f"{finite.mean():.1f} ± {finite.std():.1f}"
    return f"{finite.mean():g}" if len(finite) else "-"


def row_of(
    quantity: str, printed: str, takes: Mapping[str, SceneRuns], value: Callable[[SceneRuns], str]
) -> Row:
    """What the thesis says of a quantity, and its value for the thesis method and for the default one."""
    thesis, default = (value(take) for take in takes.values())
    return Row(quantity, printed, thesis, default)


def count_at(take: SceneRuns, t: float) -> str:
    """Number of hypotheses among the scored tracks at the update nearest to a time."""
    return count([seed.run.scores[take.nearest(t)].hypotheses for seed in take.seeds])


def right_rows(takes: Mapping[str, SceneRuns], times: Sequence[float], printed: str) -> list[Row]:
    """Features with the hypothesis of their object in each view."""
    what = "features in the right hypothesis at t ="
    return [
        row_of(f"{what} {t:.3g} s", printed, takes, partial(_right_at, view=k)) for k, t in enumerate(times)
    ]


def _right_at(take: SceneRuns, view: int) -> str:
    """Share of features with the hypothesis of their object, in one view of every seed."""
    shares = []
    for seed in take.seeds:
        moment = seed.views[view].moment
        scored = (moment.objects >= 0) & (moment.hypotheses != UNDETERMINED)
        right = rightly_assigned(moment.hypotheses[scored], moment.objects[scored]).sum()
        shares.append(100 * right / max(int((moment.objects >= 0).sum()), 1))
    return f"{spread(shares, 0)} %"


def perfect_from(take: SceneRuns) -> Any:
    """Time from which on NMI is 1, seconds, per seed; NaN where it never is."""
    times = []
    for seed in take.seeds:
        wrong = np.flatnonzero(~(seed.run.nmi > 1 - 1e-9))
        first = wrong[-1] + 1 if len(wrong) else 0
        times.append(seed.run.seconds[first] if first < len(seed.run.seconds) else np.nan)
    return np.array(times)


def best(takes: Mapping[str, SceneRuns]) -> str:
    """Label of the thesis parameters with the best mean NMI."""
    return max((label for label in takes if label != DEFAULT), key=lambda k: takes[k].mean_nmi().mean())


def summary(takes: Mapping[str, SceneRuns]) -> tuple[str, str]:
    """Mean NMI of the thesis method at its best, and of the default method."""
    label = best(takes)
    return f"{spread(takes[label].mean_nmi())} ({label})", spread(takes[DEFAULT].mean_nmi())


def rows_of_each(
    quantity: str,
    takes: Mapping[str, SceneRuns],
    claims: Iterable[str],
    value: Callable[[SceneRuns], str] = lambda take: spread(take.mean_nmi()),
) -> list[Row]:
    """A value of each take, with the claim of the thesis on each; the default method last."""
    *tried, default = map(value, takes.values())
    columns = zip(takes, claims, tried, strict=False)
    rows = [Row(f"{label}: {quantity}", text, shown, "") for label, text, shown in columns]
    return [*rows, Row(quantity, "-", "", default)]


def parameters(how: Simulated, study: Study, thesis: str = "", *, drawn: bool = True) -> dict[str, str]:
    """What a figure of a simulated scene was made with; `drawn`: it shows one seed of these."""
    scene = {"scene": f"sim:{how.scene}, {load_scene(how.scene).rate:g} Hz"}
    thesis = thesis or next(iter(how.configs)).removeprefix("thesis method, ")
    return scene | run_parameters(thesis, how.period, study.options.seeds, drawn=drawn)


def run_parameters(thesis: str, period: float, seeds: Sequence[int], *, drawn: bool) -> dict[str, str]:
    """How a scene was run: parameters of the thesis method, s between updates, seeds."""
    named = ", ".join(map(str, seeds))
    made_with = {"thesis method": thesis, "update every": f"{period:.3g} s", "seeds": named}
    return made_with | ({"drawn": f"seed {seeds[0]}"} if drawn else {})
