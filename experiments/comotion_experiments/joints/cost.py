"""What joints cost an update: the same batches through the core with joints and without."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comotion import Fusion, FusionConfig
from comotion.config import JointsConfig
from comotion_schemas import ObservationBatch

from ..bench.scene import Scene, SceneSpec

FEATURES, BODIES = 1000, 12
_SECONDS, _WARM_S = 17.0, 11.0
# At most every 150 ms a pair is judged: at this period every update judges one.
_PERIOD_NS = 200_000_000


@dataclass(frozen=True)
class Cost:
    """CPU time of one seed: ms of an update in the median, without joints and where a pair is judged."""

    without: float
    judging: float

    @property
    def share(self) -> float:
        """What judging a pair adds, as a share."""
        return self.judging / self.without - 1


def measure(seed: int) -> Cost:
    """Run one scene of 1000 features on 12 bodies and a background with and without joints, in turns."""
    scene = Scene(SceneSpec(features=FEATURES, bodies=BODIES, rate=15.0, seed=seed))
    fusions = [Fusion(FusionConfig()), Fusion(FusionConfig(joints=JointsConfig(pairs=0)))]
    times: list[list[float]] = []
    due, warm = scene.start_ns, scene.start_ns + _WARM_S * 1e9
    for batch in scene.merged(_SECONDS):
        for fusion in fusions:
            fusion.ingest(batch)
        if batch.stamp_ns >= due:
            due += _PERIOD_NS
            spent = _updates(fusions, batch, swapped=len(times) % 2 == 1)
            times += [spent] if batch.stamp_ns >= warm else []
    with_joints, without = np.median(np.array(times), axis=0).tolist()
    return Cost(without, with_joints)


def _updates(fusions: Sequence[Fusion], batch: ObservationBatch, *, swapped: bool) -> list[float]:
    """CPU ms of an update of each; which comes first alternates, as the second finds warm caches."""
    spent = [0.0, 0.0]
    for k in (1, 0) if swapped else (0, 1):
        begun = time.process_time()
        fusions[k].update(batch.stamp_ns)
        spent[k] = 1e3 * (time.process_time() - begun)
    return spent
