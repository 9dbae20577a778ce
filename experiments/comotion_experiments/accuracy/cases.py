"""Cases of the accuracy report: scenes, scenes with wrong calibrations, recordings; and their runs."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch
from comotion_schemas.errors import KnownError
from comotion_sources import simulator
from comotion_sources.recordings import read_recording, recording_streams
from comotion_sources.streams import batches

from ..inputs import Message
from ..offline import run_offline
from ..trace import objects_of, rightly_assigned

THESIS_SCENES = ("fig4_1", "fig4_3", "fig4_4", "fig3_3")
# Extrinsics (mm, degrees) and clock (ms) of the second source.
DISPLACEMENTS = (
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
    groups = {"thesis scenes": THESIS_SCENES, "3-D set": spatial}
    cases = ((group, name) for group, names in groups.items() for name in names)
    return [
        Case(name, group, partial(_simulated, name), sigma_switch=_SWITCH.get(name, _SWITCH_ELSE))
        for group, name in cases
    ]


def _simulated(scene: str, seed: int, rates: Sequence[float] | None = None) -> Iterator[Message]:
    return simulator.batches(simulator.simulate(simulator.load_scene(scene), seed=seed, rates=rates))


def displaced_cases() -> list[Case]:
    """List cases of a scene with two sources, the second with wrong extrinsics, a wrong clock, or both."""
    return [
        Case(f"{mm:g} mm, {degrees:g}°, {ms:g} ms", "two sources", partial(_displaced, mm, degrees, ms))
        for mm, degrees, ms in DISPLACEMENTS
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
    opened = ((path.stem, "recordings", partial(_recorded, path)) for path in paths)
    return [Case(*which, seeded=False, duration=_RECORDED_SECONDS) for which in opened]


def _recorded(path: Path, _: int) -> Iterable[Message]:
    return batches(recording_streams(read_recording(str(path))))


def run_case(case: Case, config: FusionConfig, seed: int, duration: float | None = None) -> dict[str, Any]:
    """Run a case through the core.

    Returns
    -------
    `nmi`: mean over all updates, `late`: from 1 s on, `whole`: at whole seconds; `switches` per 100 tracks;
    `bins` float64 [bins, 3]: for the assignments of tracks with known object, by their confidence in
    :data:`BINS`, its sum, how many are right, and how many there are.
    """
    truth, bins = Truth(), np.zeros((len(BINS) - 1, 3))

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        objects, labels = objects_of(update, truth), update.track_hypothesis
        known = (objects >= 0) & (labels != UNDETERMINED)
        confidence = update.track_confidence[known].astype(np.float64)
        right = rightly_assigned(labels[known], objects[known])
        counted = np.column_stack([confidence, right, np.ones(len(right))])
        np.add.at(bins, np.digitize(confidence, BINS) - 1, counted)

    run = run_offline(
        case.open(seed),
        config,
        truth=truth,
        period=PERIOD,
        duration=case.duration if duration is None else duration,
        on_update=on_update,
    )
    t, off = run.seconds, np.abs(run.seconds - np.round(run.seconds))
    parts = {"nmi": t > 0, "late": t >= 0.99, "whole": (off < PERIOD / 2) & (t > PERIOD)}
    means = {name: float(np.nanmean(run.nmi[part])) for name, part in parts.items() if part.any()}
    return means | {"switches": run.summary.switches_per_100, "bins": bins}
