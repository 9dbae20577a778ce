"""A process that runs the kernels of some scenes: ``python -m tests.reference.every_kernel SCENE...``.

It prints a digest of the updates and affinities of each scene, then how many kernels came from the disk.
"""

import hashlib
import sys

from comotion import Fusion, FusionConfig
from comotion_experiments.inputs import Arrived
from comotion_schemas import encode

from ..comotion_tools.bench.core import SceneSpec, messages
from ..comotion_tools.kernels import kernels

# Of so many features in metres the default method searches a subset.
SCENES = {
    "thesis": ("thesis", SceneSpec(features=300, sources=2, rate=15, churn=0.3)),
    "metres": ("comotion", SceneSpec(features=300, sources=2, rate=15, churn=0.3)),
    "pixels": ("comotion", SceneSpec(features=200, sources=1, rate=15, churn=0.3, pixels=True)),
}
SECONDS = 3.0
UPDATE_EVERY = 10


def digest(method, spec):
    fusion, found = Fusion(FusionConfig(method=method)), hashlib.sha256()
    given = (one for one in messages(spec, SECONDS) if isinstance(one, Arrived))
    for k, batch in enumerate(arrived.batch for arrived in given):
        fusion.ingest(batch)
        if k % UPDATE_EVERY == UPDATE_EVERY - 1:
            found.update(encode(fusion.update(batch.stamp_ns)))
    found.update(fusion.affinity(batch.space).matrix.tobytes())
    return found.hexdigest()


if __name__ == "__main__":
    lines = [digest(*SCENES[name]) for name in sys.argv[1:]]
    loaded = sum(sum(kernel.stats.cache_hits.values()) for kernel in kernels().values())
    sys.stdout.write("\n".join([*lines, str(loaded)]))
