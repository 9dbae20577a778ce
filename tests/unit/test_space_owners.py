"""What a space is: said by the configuration, else by the first source that observes something in it."""

from functools import partial

import numpy as np

from comotion import Fusion, FusionConfig
from comotion.config import LimitsConfig, SpaceConfig
from comotion.runtime.problems import in_words

from .. import builders
from ..builders import MS, T0, S, play, restored

POINTS = np.random.default_rng(0).uniform(-1, 1, (12, 3))
FAR = np.random.default_rng(1).uniform(-1, 1, (40, 3))


batch = partial(builders.batch, positions=POINTS)


def pixels(source, seq, stamp_ns, count):
    return batch(source, seq, stamp_ns, positions=np.full((count, 2), 7.0), unit="px")


def rejected(fusion):
    return {source: one.rejected for (source, _), one in fusion.timeline.ledger.accounts.items()}


def test_a_batch_without_rows_claims_no_space():
    fusion = Fusion()
    claims = lambda k, now: pixels("claims", k, now - MS, 0)  # noqa: E731
    update = play(fusion, range(30), claims, partial(batch, "honest"))[-1]
    assert len(update.track_id) == 12
    assert rejected(fusion)["honest"] == {}
    assert rejected(fusion)["claims"]["space-mismatch"] > 25
    assert list(fusion.timeline.troubles.lately()["contradicts-space"]) == ["claims"]
    text = in_words(fusion.timeline.troubles.lately())["claims", "contradicts-space"]
    assert "says that world has unit px and dim 2, where honest says m and 3" in text


def test_the_first_that_observes_something_keeps_the_space_while_it_lives():
    fusion = Fusion()
    other = partial(pixels, "other", count=5)
    play(fusion, range(100), lambda k, now: batch("first", k, now) if k < 90 else None, other)
    assert list(fusion.timeline.troubles.lately()["contradicts-space"]) == ["other"]
    play(fusion, range(100, 300), other)
    assert rejected(fusion)["first"] == {}
    refused = rejected(fusion)["other"]["space-mismatch"]
    assert 90 < refused < 260, "released 5 s after the first has left"


def test_a_space_of_a_snapshot_is_not_free_for_the_next_best():
    before = Fusion()
    play(before, range(30), partial(batch, "first"))
    fusion, now = restored(before), T0 + S
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


def test_where_the_configuration_names_sources_others_are_refused():
    fusion = Fusion(FusionConfig(spaces={"world": SpaceConfig(sources=("first",))}))
    for source, space in (("other", "world"), ("first", "world"), ("third", "elsewhere")):
        fusion.ingest(batch(source, 0, T0, space=space))
    update = fusion.update(T0)
    assert {one.name for one in update.sources} == {"first", "third"}
    assert rejected(fusion) == {"other": {"space-mismatch": 1}, "first": {}, "third": {}}
    fusion.ingest(batch("other", 1, T0 + MS))
    text = in_words(fusion.timeline.troubles.lately())["other", "contradicts-space"]
    assert "says that it observes in world, where the configuration names other sources" in text


def frames(fusion, ticks, *, other):
    """A source that says nothing of the frame, and another that says `other`."""
    updates = play(
        fusion,
        ticks,
        lambda k, now: batch("honest", k, now, positions=POINTS + np.array([0.01 * k, 0, 0])),
        lambda k, now: batch("other", k, now, positions=FAR, moving=other),
    )
    return updates[-1].frames


def test_a_frame_moves_where_all_sources_say_so_and_until_they_do_not():
    fusion = Fusion()
    assert frames(fusion, range(60), other=True) == {}
    assert "is carried" in fusion.timeline.troubles.lately()["contradicts-space"]["other"]
    alone = Fusion()
    assert "world" in play(alone, range(60), partial(batch, "hand", moving=True))[-1].frames
    assert play(restored(alone), range(60, 80), partial(batch, "hand", moving=False))[-1].frames == {}


def test_the_configuration_has_the_last_word_on_whether_a_frame_moves():
    still = Fusion(FusionConfig(spaces={"world": SpaceConfig(moving=False)}))
    carried = Fusion(FusionConfig(spaces={"world": SpaceConfig(moving=True)}))
    assert frames(still, range(60), other=True) == {}
    assert "world" in frames(carried, range(60), other=False)


def test_one_source_may_open_a_fourth_of_the_spaces():
    fusion = Fusion(FusionConfig(limits=LimitsConfig(spaces=8)))
    play(
        fusion,
        range(10),
        lambda k, now: batch("many", k, now, space=f"space-{k}", ids=np.arange(12) + 100 * k),
        partial(batch, "honest"),
    )
    assert sorted(fusion.spaces) == ["space-0", "space-1", "world"]
    assert rejected(fusion)["many"] == {"limit": 8}
    assert rejected(fusion)["honest"] == {}
