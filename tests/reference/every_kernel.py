"""A process that runs every kernel, or those of some scenes: ``every_kernel.py [SCENE ...] [--warm-up]``.

It prints a digest of the updates and affinities of each scene, then how many kernels came from the disk:
hardly any, if this process compiled them. With --warm-up it also compiles what a starting service needs.
"""

import hashlib
import sys
from pathlib import Path

from comotion import Fusion, FusionConfig
from comotion.precompiling import kernels
from comotion.warm_up import warm_up
from comotion_schemas import encode

sys.path.append(str(Path(__file__).parents[1]))
from comotion_tools.bench.scene import Scene, SceneSpec

# Of so many features in metres the default method searches a subset.
SCENES = {
    "thesis": ("thesis", SceneSpec(features=300, sources=2, rate=15, churn=0.3)),
    "metres": ("comotion", SceneSpec(features=300, sources=2, rate=15, churn=0.3)),
    "pixels": ("comotion", SceneSpec(features=200, sources=1, rate=15, churn=0.3, pixels=True)),
}
SECONDS = 3.0
UPDATE_EVERY = 10


def digest(method: str, spec: SceneSpec) -> str:
    fusion = Fusion(FusionConfig(method=method))
    found = hashlib.sha256()
    space = ""
    for k, batch in enumerate(Scene(spec).merged(SECONDS)):
        fusion.ingest(batch)
        space = batch.space
        if k % UPDATE_EVERY == UPDATE_EVERY - 1:
            found.update(encode(fusion.update(batch.stamp_ns)))
    found.update(fusion.affinity(space).matrix.tobytes())
    return found.hexdigest()


def main(scenes: list[str], *, warm: bool) -> None:
    lines = [digest(*SCENES[name]) for name in scenes]
    loaded = sum(sum(kernel.stats.cache_hits.values()) for kernel in kernels().values())
    # A method once: not again after the pixels.
    for method in (SCENES[name][0] for name in scenes if warm and name != "pixels"):
        for _ in warm_up(FusionConfig(method=method)):
            pass
    sys.stdout.write("\n".join([*lines, str(loaded)]))


if __name__ == "__main__":
    chosen = [argument for argument in sys.argv[1:] if argument in SCENES]
    main(chosen or list(SCENES), warm="--warm-up" in sys.argv)
