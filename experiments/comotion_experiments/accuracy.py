"""The accuracy report: the default method and the thesis method on scenes and recordings."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_clients.watch_columns import number
from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, ObservationBatch
from comotion_schemas.errors import KnownError
from comotion_sources import simulator
from comotion_sources.recordings import read_recording, recording_streams
from comotion_sources.simulator import SceneSpec, Simulation, load_scene, simulate
from comotion_sources.simulator.spec import Sines
from comotion_sources.streams import batches

from .inputs import Message
from .offline import run_offline, thesis
from .study import Row, values
from .tables import Table, filled, mean, spread
from .trace import objects_of, rightly_assigned

THESIS_SCENES, SPATIAL, DISPLACED, RECORDINGS = "thesis scenes", "3-D set", "two sources", "recordings"
"""Groups of cases."""
_OF_THESIS = ("fig4_1", "fig4_3", "fig4_4", "fig3_3")
# Extrinsics (mm, degrees) and clock (ms) of the second source.
_DISPLACEMENTS = (
    *((1, 1, 0), (5, 1, 0), (10, 2, 0), (20, 3, 0)),
    *((0, 0, 5), (0, 0, 15), (0, 0, 30), (10, 2, 20), (0, 0, 150), (0, 0, -300), (20, 3, 300)),
)
_DISPLACED_SCENE, _DISPLACED_SOURCE = "3d_3", "simulator-2"
_RATES = (15.0, 30.0)
_RECORDED_SECONDS = 60.0
# σ_switch of the thesis method, m: the best value for each scene.
_SWITCH = {"fig4_1": 0.02}
_SWITCH_ELSE = 0.01
PERIOD = 1 / 3
"""s between updates."""
BINS = np.array([0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9])
"""Bounds of confidence."""


@dataclass(frozen=True)
class Case:
    """One line of the report."""

    name: str
    group: str  # its table
    open: Callable[[int], Iterable[Message]]  # maps a seed to messages
    seeded: bool = True  # whether the messages depend on the seed
    duration: float | None = None  # s to run; None: all
    sigma_switch: float = _SWITCH_ELSE  # m; for the thesis method


def scene_cases() -> list[Case]:
    """List the scenes of the thesis, and all 3-D scenes of the simulator."""
    spatial = [name for name in simulator.scene_names() if name.startswith("3d_")]
    cases = [(THESIS_SCENES, name) for name in _OF_THESIS] + [(SPATIAL, name) for name in spatial]
    return [
        Case(name, group, partial(_simulated, name), sigma_switch=_SWITCH.get(name, _SWITCH_ELSE))
        for group, name in cases
    ]


def _simulated(scene: str, seed: int, rates: Sequence[float] | None = None) -> Iterator[Message]:
    return simulator.batches(simulator.simulate(simulator.load_scene(scene), seed=seed, rates=rates))


def displaced_cases() -> list[Case]:
    """List cases of a scene with two sources, the second with wrong extrinsics, a wrong clock, or both."""
    return [
        Case(f"{mm:g} mm, {degrees:g}°, {ms:g} ms", DISPLACED, partial(_displaced, mm, degrees, ms))
        for mm, degrees, ms in _DISPLACEMENTS
    ]


def _displaced(millimetres: float, degrees: float, milliseconds: float, seed: int) -> list[Message]:
    rng = np.random.default_rng([seed, 7])
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn, shift = Rotation.from_rotvec(axis * np.radians(degrees)).as_matrix(), way * millimetres * 1e-3
    truths: list[Message] = []
    observed: list[ObservationBatch] = []
    for message in _simulated(_DISPLACED_SCENE, seed, _RATES):
        if not isinstance(message, ObservationBatch):
            truths.append(message)
            continue
        positions = (message.positions.astype(np.float64) @ turn.T + shift).astype(np.float32)
        stamp_ns = message.stamp_ns + round(milliseconds * 1e6)
        wrong = replace(message, positions=positions, stamp_ns=stamp_ns)
        observed.append(wrong if message.source == _DISPLACED_SOURCE else message)
    return [*truths, *sorted(observed, key=lambda m: m.stamp_ns)]


def recorded_cases(folder: Path) -> list[Case]:
    """List the labelled marker recordings (.npz) in a folder.

    Raises
    ------
    ValueError
        If there is none, or one is unreadable.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise KnownError(f"{folder}: no .npz recordings")
    opened = ((path.stem, RECORDINGS, partial(_recorded, path)) for path in paths)
    return [Case(*which, seeded=False, duration=_RECORDED_SECONDS) for which in opened]


def _recorded(path: Path, _: int) -> Iterable[Message]:
    return batches(recording_streams(read_recording(str(path))))


def run_case(case: Case, config: FusionConfig, seed: int) -> dict[str, Any]:
    """Run a case through the core.

    Returns
    -------
    `nmi`: mean over all updates, `late`: from 1 s on; `switches` per 100 tracks;
    `bins` float64 [bins, 3]: for the assignments of tracks with known object, by their confidence in
    :data:`BINS`, its sum, how many are right, and how many there are.
    """
    truth, bins = Truth(), np.zeros((len(BINS) - 1, 3))

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        objects, labels = objects_of(update, truth), update.track_hypothesis
        scored = (objects >= 0) & (labels != UNDETERMINED)
        confidence = update.track_confidence[scored].astype(np.float64)
        right = rightly_assigned(labels[scored], objects[scored])
        counted = np.column_stack([confidence, right, np.ones(len(right))])
        np.add.at(bins, np.digitize(confidence, BINS) - 1, counted)

    run = run_offline(
        case.open(seed),
        config,
        truth=truth,
        period=PERIOD,
        duration=case.duration,
        on_update=on_update,
    )
    figures = {"nmi": float(np.nanmean(run.nmi)), "late": float(np.nanmean(run.nmi[run.seconds >= 0.99]))}
    return figures | {"switches": run.summary.switches_per_100, "bins": bins}


SPEEDS = (0.2, 0.4)
_SIGMA = 0.005
_STEP = 1e-3


def motion_errors(seeds: Sequence[int]) -> dict[str, float]:
    """Run the scene for each seed with the default method; medians of the errors over updates and bodies."""
    # A background and two bodies of the 3-D set, with as much noise and motion as the report says.
    spec, errors = load_scene("3d_3"), list[tuple[float, ...]]()
    still, *moving = spec.bodies
    motion = Sines(kind="sines", within=0.6, amplitude=0.35, rotation=1.5)
    changes = {"features": 10, "size": [0.3, 0.3, 0.3], "sigma": _SIGMA, "motion": motion}
    bodies = [still.model_copy(update={"sigma": _SIGMA}), *(b.model_copy(update=changes) for b in moving)]
    for seed in seeds:
        _run(spec.model_copy(update={"bodies": bodies, "respawn": None}), seed, errors)
    rotation, translation, linear, angular, speed = np.array(errors).T
    fast = (speed >= SPEEDS[0]) & (speed <= SPEEDS[1])
    return {
        "rotation, degrees": float(np.degrees(np.median(rotation))),
        "translation of the centroid, mm": float(1e3 * np.median(translation)),
        "velocity at 0.2 to 0.4 m/s, %": float(100 * np.median((linear / speed)[fast])),
        "angular velocity, degrees/s": float(np.degrees(np.median(angular))),
    }


def _run(spec: SceneSpec, seed: int, errors: list[tuple[float, ...]]) -> None:
    (simulation,) = simulate(spec, seed=seed)
    truth = Truth()

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        objects = objects_of(update, truth)
        for hypothesis in update.hypotheses:
            members = objects[update.track_hypothesis == hypothesis.id]
            body = Counter(members[members >= 0].tolist()).most_common(1)
            if body and body[0][0] > 0:
                errors.extend(_errors(simulation, body[0][0], hypothesis, update.stamp_ns))

    run_offline(batches(simulation), FusionConfig(), truth=truth, period=PERIOD, on_update=on_update)


def _errors(
    simulation: Simulation, body: int, hypothesis: Hypothesis, stamp_ns: int
) -> Iterator[tuple[float, ...]]:
    """Errors of a hypothesis with a motion in rad, m, m/s and rad/s, and the true speed, m/s."""
    if hypothesis.pose is None or hypothesis.twist is None:
        return
    now, born = stamp_ns * 1e-9, hypothesis.born_ns * 1e-9
    poses = simulation.poses(body, np.array([born, now - _STEP, now, now + _STEP]))
    R, t = poses.rotations, poses.translations
    turned = Rotation.from_quat(np.asarray(hypothesis.pose.rotation)).as_matrix()
    moved = turned @ t[0] + np.asarray(hypothesis.pose.translation)
    rest = Rotation.from_matrix(turned.T @ R[2] @ R[0].T)
    centroid = R[2].T @ (np.asarray(hypothesis.centroid) - t[2])
    velocity = ((R[3] - R[1]) @ centroid + t[3] - t[1]) / (2 * _STEP)
    spin = Rotation.from_matrix(R[3] @ R[1].T).as_rotvec() / (2 * _STEP)
    linear = np.asarray(hypothesis.twist.linear) - velocity
    angular = np.asarray(hypothesis.twist.angular) - spin
    lengths = (np.linalg.norm(vector) for vector in (moved - t[2], linear, angular, velocity))
    yield float(rest.magnitude()), *map(float, lengths)


METHODS = DEFAULT, THESIS = "comotion", "thesis"
PARTS = ("scores", "motion")
"""Parts of the report: both methods on every case, and poses."""
# Scenes in which the truth separates bodies that have not moved yet, so no method can.
_UNKNOWABLE = ("fig4_3", "fig3_3", "3d_late", "3d_static")
_PLACES = {
    THESIS_SCENES: "thesis_scenes",
    SPATIAL: "space",
    DISPLACED: "two_sources",
    RECORDINGS: "recordings",
}
"""Where each group of cases stands in the page."""


def run_method(case: Case, method: str, seed: int) -> Row:
    """Run a case under one of :data:`METHODS`."""
    return run_case(case, FusionConfig() if method == DEFAULT else thesis(case.sigma_switch), seed)


def markdown(results: dict[str, Any]) -> str:
    """Format the report: of `seeds`, the `rows` of all cases, and `motion`, as far as they are there."""
    page: dict[str, str | Table] = {"seeds": ", ".join(map(str, results["seeds"]))}
    if "rows" in results:
        rows = results["rows"]
        page |= {_PLACES[group]: _table(rows, group) for group in dict.fromkeys(row["group"] for row in rows)}
        page["reliability"] = _reliability(rows)
    if "motion" in results:
        medians = [(name, f"{value:.2f}") for name, value in results["motion"].items()]
        page["motion"] = Table(("error", "median"), rows=[*medians])
    return filled(Path(__file__).with_suffix(".md"), page)


def _table(rows: Sequence[Row], group: str) -> Table:
    table = Table(["", "default", "t ≥ 1 s", "switches", "thesis", "switches"])
    for name in dict.fromkeys(row["case"] for row in rows if row["group"] == group):
        ours, theirs = ({"case": name, "setting": method} for method in METHODS)
        table.add(
            name,
            spread(values(rows, "nmi", **ours)),
            spread(values(rows, "late", **ours)),
            number(mean(values(rows, "switches", **ours)), 2),
            spread(values(rows, "nmi", **theirs)),
            number(mean(values(rows, "switches", **theirs)), 2),
        )
    if group == RECORDINGS:
        nmi = (values(rows, "nmi", group=group, setting=method) for method in METHODS)
        table.add("**mean**", f"**{mean(next(nmi)):.3f}**", "", "", f"{mean(next(nmi)):.3f}", "")
    return table


def _reliability(rows: Sequence[Row]) -> Table:
    """Mean confidence, share of right assignments and count of each bin that is not empty, of scenes."""
    table = Table(("confidence", "right", "assignments"), 0)
    scenes = [row for row in rows if row["group"] in (THESIS_SCENES, SPATIAL)]
    separable = [row for row in scenes if row["case"] not in _UNKNOWABLE]
    for confidence, right, n in sum(values(separable, "bins", setting=DEFAULT), np.zeros((1, 3))).tolist():
        if n:
            table.add(f"{confidence / n:.3f}", f"{right / n:.3f}", f"{n:.0f}")
    return table
