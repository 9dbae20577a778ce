"""Invariants of the simulator over random scenes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion_sources.simulator import SceneSpec, simulate

rates = st.floats(1.0, 60.0)


@st.composite
def motions(draw, dim):
    kind = draw(st.sampled_from(["rest", "key-states", "sines"]))
    if kind == "rest":
        return {"kind": kind, "within": draw(st.floats(0, 2))}
    if kind == "sines":
        return {"kind": kind, "amplitude": draw(st.floats(0, 1)), "rotation": draw(st.floats(0, 4))}
    times = sorted(draw(st.sets(st.integers(0, 8), min_size=1, max_size=4)))
    width = dim + (1 if dim == 2 else 3)
    row = st.lists(st.floats(-3, 3), min_size=width, max_size=width)
    return {"kind": kind, "states": [[t, *draw(row)] for t in times]}


@st.composite
def specs(draw):
    dim = draw(st.sampled_from([2, 3]))
    bodies = [
        {
            "name": f"b{k}",
            "features": draw(st.integers(0, 6)),
            "poses": draw(st.integers(0, 1)) if dim == 3 else 0,
            "size": draw(st.just({"min": 0.1, "max": 0.4}) | st.just([0.3] * dim)),
            "sigma": draw(st.floats(0, 0.1)),
            "motion": draw(motions(dim)),
        }
        for k in range(draw(st.integers(1, 3)))
    ]
    options = {}
    if draw(st.booleans()):
        options["respawn"] = {"every": draw(st.floats(0.3, 3)), "share": draw(st.floats(0, 1))}
    if draw(st.booleans()):
        options["gaps"] = {"share": draw(st.floats(0, 1)), "shortest": 0.1, "longest": 0.5}
    return SceneSpec(title="random", dim=dim, duration=draw(st.floats(0.1, 5)), bodies=bodies, **options)


@settings(max_examples=60)
@given(specs(), st.integers(0, 2**32), st.lists(rates, min_size=1, max_size=4), st.booleans())
def test_sources_of_any_rate_share_one_consistent_world(spec, seed, chosen, by_object):
    split = "objects" if by_object else "features"
    owners, objects = {}, {}
    for source in simulate(spec, seed=seed, rates=chosen, split=split):
        ended, frames = set(), 0
        for frame in source:
            frames += 1
            ids = frame.ids.tolist()
            assert frame.t <= spec.duration + 1e-6
            assert np.isfinite(frame.positions).all()
            assert len(set(ids)) == len(ids)
            ended |= set(frame.ended.tolist())
            assert not ended & set(ids)
            for identity, number_of_object in zip(ids, frame.objects.tolist(), strict=True):
                assert owners.setdefault(identity, source.part) == source.part
                assert objects.setdefault(identity, number_of_object) == number_of_object
        assert frames == len(source)
