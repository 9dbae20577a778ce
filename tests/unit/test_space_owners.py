"""What a space is: said by the configuration, else by the first source that observes something in it."""

import numpy as np

from comotion import Fusion, FusionConfig
from comotion.config import LimitsConfig, SpaceConfig
from comotion.runtime.problems import of_fusion

from .. import builders
from ..builders import MS, T0

POINTS = np.random.default_rng(0).uniform(-1, 1, (12, 3))
FAR = np.random.default_rng(1).uniform(-1, 1, (40, 3))


def batch(source, seq, stamp_ns, positions=POINTS, **fields):
    return builders.batch(source, seq, stamp_ns, positions, **fields)


def pixels(source, seq, stamp_ns, count):
    return batch(source, seq, stamp_ns, np.full((count, 2), 7.0), unit="px")


def rejected(fusion):
    return {source: one.rejected for (source, _), one in fusion.timeline.ledger.accounts().items()}


def test_a_batch_without_rows_claims_no_space():
    fusion = Fusion()
    for k in range(30):
        now = T0 + k * 33 * MS
        fusion.ingest(pixels("claims", k, now - MS, 0))
        fusion.ingest(batch("honest", k, now))
        update = fusion.update(now)
    assert len(update.track_id) == 12
    assert rejected(fusion)["honest"] == {}
    assert rejected(fusion)["claims"]["space-mismatch"] > 25
    assert list(fusion.timeline.troubles.lately()["contradicts-space"]) == ["claims"]
    text = of_fusion(fusion)["claims", "contradicts-space"]
    assert "says that world has unit px and dim 2, where honest says m and 3" in text


def test_the_first_that_observes_something_keeps_the_space_while_it_lives():
    fusion = Fusion()
    for k in range(300):
        now = T0 + k * 33 * MS
        if k < 90:
            fusion.ingest(batch("first", k, now))
        fusion.ingest(pixels("other", k, now, 5))
        fusion.update(now)
        if k == 100:
            assert list(fusion.timeline.troubles.lately()["contradicts-space"]) == ["other"]
    assert rejected(fusion)["first"] == {}
    refused = rejected(fusion)["other"]["space-mismatch"]
    assert 90 < refused < 260, "released 5 s after the first has left"


def test_a_space_of_a_snapshot_is_not_free_for_the_next_best():
    before = Fusion()
    for k in range(30):
        before.ingest(batch("first", k, T0 + k * 33 * MS))
        before.update(T0 + k * 33 * MS)
    fusion = Fusion.restore(before.config, before.snapshot())
    now = T0 + 30 * 33 * MS
    fusion.advance(now)
    fusion.ingest(pixels("other", 0, now, 5))
    fusion.ingest(batch("first", 30, now))
    assert len(fusion.update(now).track_id) == 12
    assert rejected(fusion)["other"] == {"space-mismatch": 1}


def test_the_configuration_decides_before_anybody_observes():
    fusion = Fusion(FusionConfig(spaces={"world": SpaceConfig(unit="m", dim=3)}))
    fusion.ingest(pixels("first", 0, T0, 5))
    fusion.ingest(batch("second", 0, T0 + MS))
    assert len(fusion.update(T0 + MS).track_id) == 12
    assert rejected(fusion)["first"] == {"space-mismatch": 1}
    fusion.ingest(pixels("first", 1, T0 + 2 * MS, 5))
    assert "the configuration says m and 3" in fusion.timeline.troubles.lately()["contradicts-space"]["first"]


def frames(fusion, ticks, *, other):
    """A source that says nothing of the frame, and another that says `other`, or is gone where None."""
    for k in ticks:
        now = T0 + k * 33 * MS
        fusion.ingest(batch("honest", k, now, POINTS + np.array([0.01 * k, 0, 0])))
        if other is not None:
            fusion.ingest(batch("other", k, now, FAR, moving=other))
        update = fusion.update(now)
    return update.frames


def test_a_frame_moves_where_all_sources_say_so_and_until_they_do_not():
    fusion = Fusion()
    assert frames(fusion, range(60), other=True) == {}
    assert "is carried" in fusion.timeline.troubles.lately()["contradicts-space"]["other"]
    alone = Fusion()
    for k in range(60):
        now = T0 + k * 33 * MS
        alone.ingest(batch("hand", k, now, moving=True))
        update = alone.update(now)
    assert "world" in update.frames
    alone = Fusion.restore(alone.config, alone.snapshot())
    for k in range(60, 80):
        now = T0 + k * 33 * MS
        alone.ingest(batch("hand", k, now, moving=False))
        update = alone.update(now)
    assert update.frames == {}


def test_the_configuration_has_the_last_word_on_whether_a_frame_moves():
    still = Fusion(FusionConfig(spaces={"world": SpaceConfig(moving=False)}))
    carried = Fusion(FusionConfig(spaces={"world": SpaceConfig(moving=True)}))
    assert frames(still, range(60), other=True) == {}
    assert "world" in frames(carried, range(60), other=False)


def test_one_source_may_open_a_fourth_of_the_spaces():
    fusion = Fusion(FusionConfig(limits=LimitsConfig(spaces=8)))
    for k in range(10):
        now = T0 + k * 33 * MS
        fusion.ingest(batch("many", k, now, space=f"space-{k}", ids=np.arange(12, dtype=np.uint64) + 100 * k))
        fusion.ingest(batch("honest", k, now, space="world"))
        fusion.update(now)
    assert sorted(fusion.spaces) == ["space-0", "space-1", "world"]
    assert rejected(fusion)["many"] == {"limit": 8}
    assert rejected(fusion)["honest"] == {}
