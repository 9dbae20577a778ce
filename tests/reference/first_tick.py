"""A process that prepares as a service does and then meets everything for the first time.

``python -m tests.reference.first_tick METHOD`` prints a digest of all updates and affinities and how many
kernels came from the disk, then the kernels that had to be compiled, or loaded, after it was ready: none.
Without a folder that can be written to, as NUMBA_CACHE_DIR says, this process compiles all itself; what it
has compiled before it was ready is printed too.
"""

import hashlib
import sys

import numpy as np

from comotion import Fusion, FusionConfig
from comotion.compiled import KERNELS
from comotion.config import Camera
from comotion.warm_up import prepare
from comotion_schemas import encode

from ..builders import MS, SESSION, T0, batch

FRAMES, RATE_MS = 75, 40
CAMERA = Camera(
    fx=400, fy=400, cx=320, cy=240, translation=(0, -2, 0), quaternion=(-0.7071068, 0, 0, 0.7071068)
)


def bodies(rng, count, dim, t):
    """A body that rests and one that turns and moves, float64 [2 count, dim]."""
    rest, moving = rng.uniform(-0.3, 0.3, (2, count, dim))
    turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    moving[:, :2] = moving[:, :2] @ turn.T + [0.8 + 0.4 * np.sin(2 * t), 0.2]
    return np.concatenate([rest, moving])


def stream(name, count, dim, unit, space="", sigma=None, turned=False, instants=False, ended=False):
    """Batches of one source; the options say which optional columns they have."""
    scale, ids = 400.0 if unit == "px" else 1.0, np.arange(2 * count, dtype=np.uint64)
    turns = np.where(ids[:, None] % 2, np.float32([0, 0, 0, 1]), np.nan) if turned else None
    for k in range(FRAMES):
        stamp = T0 + k * RATE_MS * MS
        positions = bodies(np.random.default_rng(5), count, dim, k * RATE_MS / 1000)
        positions += 0.002 * np.random.default_rng(k).normal(size=positions.shape)
        columns = {
            "sigma": sigma and (0.002 * scale if sigma == "number" else np.full(2 * count, 0.002 * scale)),
            "quaternions": turns,
            "stamps_ns": stamp - 5 * MS * (np.arange(2 * count)[::-1] % 3) if instants else None,
            "ended": np.arange(3, dtype=np.uint64) if ended and k == 50 else None,
            "ids": ids + np.uint64(1000) * ((k + ids) // np.uint64(60)),
        }
        yield batch(name, k, stamp, scale * positions, space=space or unit, unit=unit, **columns)


SCENES = {
    "3-D": [stream("a", 12, 3, "m")],
    "2-D": [stream("a", 12, 2, "m", sigma="number")],
    "pixels": [stream("a", 25, 2, "px", sigma="column")],
    "pixels with a disparity": [stream("a", 12, 3, "px")],
    "orientations and noise": [stream("a", 6, 3, "m", turned=True, sigma="column"), stream("b", 12, 3, "m")],
    "instants and ends": [stream("a", 12, 3, "m", instants=True, ended=True)],
    "many": [stream("a", 200, 3, "m"), stream("b", 40, 3, "m", sigma="number")],
    "links": [stream("a", 12, 3, "m", space="world"), stream("door", 25, 2, "px", space="door")],
}


def signatures():
    """Those of every kernel of the core that this process has imported, by ``module:name``."""
    return {f"{one.py_func.__module__}:{one.py_func.__qualname__}": set(one.signatures) for one in KERNELS}


def run(config, streams, digest):
    """Fuse streams, some batches late, and ask for all that can be asked for."""
    fusion = Fusion(config, session=SESSION)
    for k, batches in enumerate(zip(*streams, strict=True)):
        for one in batches[:: -1 if k % 5 == 0 else 1]:
            fusion.ingest(one)
        if k % 3 == 2:
            digest.update(encode(fusion.update(batches[0].stamp_ns)))
    for space in fusion.spaces:
        digest.update(fusion.affinity(space).matrix.tobytes())
    again = Fusion.restore(config, fusion.snapshot())
    again.update(T0 + (FRAMES * RATE_MS + 200) * MS)
    again.forget()
    # Long after: what is in the window leaves it.
    again.update(T0 + 60_000 * MS)


def main(method):
    """Prepare, run, and say what was new."""
    for _ in prepare(FusionConfig(method=method)):
        pass
    new = [f"compiled here: {kernel.py_func.__qualname__}" for kernel in KERNELS if kernel.stats.cache_misses]
    before, digest = signatures(), hashlib.sha256()
    for scene, streams in SCENES.items():
        cameras = {"door": CAMERA} if scene == "links" else {}
        run(FusionConfig(method=method, window=2.0, linking={"cameras": cameras}), streams, digest)
        after = signatures()
        new += [f"{scene}: {name}{one}" for name in after for one in after[name] - before.get(name, set())]
        before = after
    loaded = sum(sum(kernel.stats.cache_hits.values()) for kernel in KERNELS)
    sys.stdout.write("\n".join([digest.hexdigest(), str(loaded), *new]))


if __name__ == "__main__":
    main(sys.argv[1])
