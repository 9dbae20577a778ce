"""Accuracy of the pose since birth and of the twist, on simulated bodies with known motion."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_schemas import Hypothesis, HypothesisUpdate
from comotion_sources.simulator import SceneSpec, Simulation, batches, load_scene, simulate
from comotion_sources.simulator.spec import Sines

from ..offline import run_offline
from ..trace import objects_of
from .cases import PERIOD

SPEEDS = (0.2, 0.4)
_SIGMA = 0.005
_STEP = 1e-3


def motion_errors(seeds: Sequence[int]) -> dict[str, float]:
    """Run the scene for each seed with the default method; medians of the errors over updates and bodies."""
    errors: list[tuple[float, ...]] = []
    for seed in seeds:
        _run(seed, errors)
    rotation, translation, linear, angular, speed = np.array(errors).T
    fast = (speed >= SPEEDS[0]) & (speed <= SPEEDS[1])
    return {
        "rotation, degrees": float(np.degrees(np.median(rotation))),
        "translation of the centroid, mm": float(1e3 * np.median(translation)),
        "velocity at 0.2 to 0.4 m/s, %": float(100 * np.median((linear / speed)[fast])),
        "angular velocity, degrees/s": float(np.degrees(np.median(angular))),
    }


def _scene() -> SceneSpec:
    """A background and two bodies of the 3-D set, with as much noise and motion as the report says."""
    spec = load_scene("3d_3")
    rest, *moving = spec.bodies
    motion = Sines(kind="sines", within=0.6, amplitude=0.35, rotation=1.5)
    changes = {"features": 10, "size": [0.3, 0.3, 0.3], "sigma": _SIGMA, "motion": motion}
    bodies = [rest.model_copy(update={"sigma": _SIGMA}), *(b.model_copy(update=changes) for b in moving)]
    return spec.model_copy(update={"bodies": bodies, "respawn": None})


def _run(seed: int, errors: list[tuple[float, ...]]) -> None:
    (simulation,) = simulate(_scene(), seed=seed)
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
