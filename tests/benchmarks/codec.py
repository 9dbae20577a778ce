"""Time to encode and decode a batch of N features: ``python tests/benchmarks/codec.py [N ...]``."""

import sys
import timeit

import numpy as np

from comotion_schemas import ObservationBatch, decode, encode

ROUNDS, CALLS = 30, 200


def batch(count: int, *, full: bool) -> ObservationBatch:
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return ObservationBatch(
        source="benchmark",
        session="0" * 16,
        seq=0,
        space="world",
        unit="m",
        dim=3,
        stamp_ns=0,
        ids=np.arange(count, dtype=np.uint64),
        positions=rng.normal(size=(count, 3)),
        sigma=rng.uniform(0.1, 1, count) if full else None,
        quaternions=quaternions if full else None,
        stamps_ns=np.zeros(count, np.int64) if full else None,
    )


def main() -> None:
    for count in [int(text) for text in sys.argv[1:]] or [1000]:
        for full in (False, True):
            message = batch(count, full=full)
            payload = encode(message)
            best = [
                min(timeit.repeat(call, number=CALLS, repeat=ROUNDS)) / CALLS * 1e6
                for call in (lambda m=message: encode(m), lambda p=payload: decode(p))
            ]
            kind = "every column" if full else "ids, positions"
            times = f"encode {best[0]:6.1f} µs  decode {best[1]:6.1f} µs"
            print(f"N {count:>6}  {kind:<15} {len(payload):>8} B  {times}")


if __name__ == "__main__":
    main()
