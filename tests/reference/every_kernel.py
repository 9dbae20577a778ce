"""A process that runs every kernel; it prints digests of what it computed, and how many kernels it loaded.

One line each for the updates and affinities of three scenes, then the number of kernels that came from
the disk: none, if this process compiled them all.
"""

import hashlib
import sys

from comotion import Fusion, FusionConfig
from comotion.runtime.known_kernels import kernels
from comotion.runtime.warm_up import warm_up
from comotion_experiments.bench.scene import Scene, SceneSpec
from comotion_schemas import encode

# Of so many features in metres the default method searches a subset.
SCENES = (
    ("thesis", SceneSpec(features=300, sources=2, rate=15, churn=0.3), 3.0),
    ("comotion", SceneSpec(features=300, sources=2, rate=15, churn=0.3), 3.0),
    ("comotion", SceneSpec(features=200, sources=1, rate=15, churn=0.3, pixels=True), 3.0),
)
UPDATE_EVERY = 10


def digest(config: FusionConfig, spec: SceneSpec, seconds: float) -> str:
    fusion = Fusion(config)
    found = hashlib.sha256()
    space = ""
    for k, batch in enumerate(Scene(spec).merged(seconds)):
        fusion.ingest(batch)
        space = batch.space
        if k % UPDATE_EVERY == UPDATE_EVERY - 1:
            found.update(encode(fusion.update(batch.stamp_ns)))
    found.update(fusion.affinity(space).matrix.tobytes())
    return found.hexdigest()


def main() -> None:
    lines = [digest(FusionConfig(method=method), spec, seconds) for method, spec, seconds in SCENES]
    for method in ("comotion", "thesis"):
        for _ in warm_up(FusionConfig(method=method)):
            pass
    loaded = sum(sum(kernel.stats.cache_hits.values()) for kernel in kernels().values())
    sys.stdout.write("\n".join([*lines, str(loaded)]))


if __name__ == "__main__":
    main()
