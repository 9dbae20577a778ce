"""A process that prepares as a service does and then meets everything for the first time.

It prints the kernels that had to be compiled, or loaded, after it was ready: none. With an empty folder in
NUMBA_CACHE_DIR another process compiles all before, which takes minutes; what this one has compiled itself
is printed too. An argument is the method.
"""

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from comotion import Fusion, FusionConfig
from comotion.linking import Camera
from comotion.precompiling import kernels
from comotion.warm_up import prepare
from comotion_schemas import ObservationBatch, encode

T0, MS = 1_700_000_000_000_000_000, 1_000_000
FRAMES, RATE_MS = 75, 40
CAMERA = Camera(
    fx=400, fy=400, cx=320, cy=240, translation=(0, -2, 0), quaternion=(-0.7071068, 0, 0, 0.7071068)
)


def bodies(rng: np.random.Generator, count: int, dim: int, t: float) -> np.ndarray:
    """A body that rests and one that turns and moves, float64 [2 count, dim]."""
    rest, moving = rng.uniform(-0.3, 0.3, (2, count, dim))
    turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    moving[:, :2] = moving[:, :2] @ turn.T + [0.8 + 0.4 * np.sin(2 * t), 0.2]
    return np.concatenate([rest, moving])


def stream(name: str, count: int, dim: int, unit: str, **options: Any) -> Iterator[ObservationBatch]:
    """Batches of one source; `options` say which optional columns they have."""
    scale = 400.0 if unit == "px" else 1.0
    for k in range(FRAMES):
        t = k * RATE_MS / 1000
        positions = scale * bodies(np.random.default_rng(5), count, dim, t)
        positions += scale * 0.002 * np.random.default_rng(k).normal(size=positions.shape)
        rows, columns = len(positions), {}
        stamp = T0 + k * RATE_MS * MS
        if options.get("sigma") == "number":
            columns["sigma"] = 0.002 * scale
        elif options.get("sigma"):
            columns["sigma"] = np.full(rows, 0.002 * scale, np.float32)
        if options.get("turned"):
            turns = np.tile(np.float32([0, 0, 0, 1]), (rows, 1))
            turns[::2] = np.nan
            columns["quaternions"] = turns
        if options.get("instants"):
            columns["stamps_ns"] = stamp - 5 * MS * (np.arange(rows)[::-1] % 3)
        if options.get("ended") and k == 50:
            columns["ended"] = np.arange(3, dtype=np.uint64)
        ids = np.arange(rows, dtype=np.uint64)
        ids += np.uint64(1000) * ((k + ids) // np.uint64(60))
        yield ObservationBatch(
            source=name, session="a" * 16, seq=k, space=options.get("space", unit), unit=unit, dim=dim,
            stamp_ns=stamp, ids=ids, positions=positions.astype(np.float32), **columns,
        )  # fmt: skip


SCENES: dict[str, list[Iterator[ObservationBatch]]] = {
    "3-D": [stream("a", 12, 3, "m")],
    "2-D": [stream("a", 12, 2, "m", sigma="number")],
    "pixels": [stream("a", 25, 2, "px", sigma="column")],
    "pixels with a disparity": [stream("a", 12, 3, "px")],
    "orientations and noise": [stream("a", 6, 3, "m", turned=True, sigma="column"), stream("b", 12, 3, "m")],
    "instants and ends": [stream("a", 12, 3, "m", instants=True, ended=True)],
    "many": [stream("a", 200, 3, "m"), stream("b", 40, 3, "m", sigma="number")],
    "links": [stream("a", 12, 3, "m", space="world"), stream("door", 25, 2, "px", space="door")],
}


def run(config: FusionConfig, streams: list[Iterator[ObservationBatch]]) -> None:
    """Fuse streams, some batches late, and ask for all that can be asked for."""
    fusion = Fusion(config)
    for k, batches in enumerate(zip(*streams, strict=True)):
        for batch in batches[:: -1 if k % 5 == 0 else 1]:
            fusion.ingest(batch)
        if k % 3 == 2:
            encode(fusion.update(batches[0].stamp_ns))
    for space in fusion.spaces:
        fusion.affinity(space)
    again = Fusion.restore(config, fusion.snapshot())
    again.update(T0 + (FRAMES * RATE_MS + 200) * MS)
    again.forget()
    # Long after: what is in the window leaves it.
    again.update(T0 + 60_000 * MS)


def main(method: str) -> None:
    """Prepare, run, and say what was new."""
    for _ in prepare(FusionConfig(method=method)):
        pass
    for name, kernel in kernels().items():
        if kernel.stats.cache_misses:
            sys.stdout.write(f"compiled here: {name}\n")
    before = {name: set(kernel.signatures) for name, kernel in kernels().items()}
    for scene, streams in SCENES.items():
        cameras = {"door": CAMERA} if scene == "links" else {}
        run(FusionConfig(method=method, window=2.0, linking={"cameras": cameras}), streams)
        for name, kernel in kernels().items():
            for signature in set(kernel.signatures) - before.get(name, set()):
                sys.stdout.write(f"{scene}: {name}{signature}\n")
            before[name] = set(kernel.signatures)


if __name__ == "__main__":
    main(sys.argv[1])
