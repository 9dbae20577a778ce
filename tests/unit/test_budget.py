"""What one source costs, nobody else pays: time is counted here, not measured."""

from itertools import repeat

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.event_time.budget import Budget, Turns
from comotion.rigid.method import RigidMethod
from comotion.runtime.health import in_words

from ..builders import MS, T0, S, batch, settled

POINTS = np.random.default_rng(0).uniform(-1, 1, (12, 3))


def instants(source, seq, now_ns, count=1000):
    """A batch whose rows have stamps of their own."""
    stamps = now_ns - np.arange(count)[::-1] * 30_000
    return batch(source, seq, now_ns, np.full((count, 3), 0.1), stamps_ns=stamps)


def accounts(fusion):
    return {source: one for (source, _), one in fusion.timeline.ledger.accounts.items()}


class TestInstants:
    def run(self, fusion, seconds):
        """An honest source at 30 Hz beside one that packs 1000 instants into each batch."""
        for k in range(30 * seconds):
            now = T0 + k * 33 * MS
            fusion.ingest(batch("honest", k, now, POINTS))
            fusion.ingest(instants("many", k, now))
            fusion.advance(now)
            if k % 3 == 2:
                update = fusion.update(now)
        assert fusion.stats.batches == settled(fusion.stats)
        return update

    def test_who_costs_too_much_waits_then_loses_his_own_and_is_named(self):
        fusion = Fusion(FusionConfig())
        fusion.measure(lambda: fusion.stats.observations * 100_000)
        update = self.run(fusion, 6)
        listed = accounts(fusion)
        assert listed["honest"].fused == 30 * 6
        assert listed["honest"].rejected == {}
        assert listed["many"].rejected["over-budget"] > 60
        assert listed["many"].fused > 10, "he has his share"
        assert listed["many"].waiting < 60
        assert list(fusion.timeline.troubles.lately()["over-budget"]) == ["many"]
        assert ("many", "over-budget") in in_words(fusion.timeline.troubles.lately())
        honest = [k for k, one in enumerate(update.sources) if one.name == "honest"]
        assert (update.track_source == honest[0]).sum() == 12

    def test_however_many_names_somebody_takes_the_others_keep_their_share(self):
        fusion = Fusion(FusionConfig())
        fusion.measure(lambda: fusion.stats.observations * 200_000)
        for k in range(110):
            now = T0 + k * 33 * MS
            fusion.ingest(batch("honest", k, now, POINTS))
            # Each name once, after the honest one has become known.
            for n in range(20 if k > 35 else 0):
                fusion.ingest(batch(f"name-{k}-{n}", 0, now, POINTS[:6]))
            (fusion.update if k % 3 == 2 else fusion.advance)(now)
        listed = accounts(fusion)
        assert listed["honest"].fused == listed["honest"].batches - listed["honest"].waiting
        assert fusion.stats.rejected["over-budget"] > 100
        assert all(name.startswith("name") for name in fusion.timeline.troubles.lately()["over-budget"])

    @pytest.mark.parametrize("spenders", ["a", "abc"])
    def test_a_pause_of_the_machine_mutes_nobody_for_long(self, spenders):
        budget = Budget(0.5, 100 * MS, clock := Clock())
        next(budget.rounds(0, lambda: spenders))
        clock.spend(budget, "a", 60 * S)
        rounds = 0
        while not budget.allows("a"):
            rounds += 1
            next(budget.rounds(rounds * 100 * MS, lambda: spenders))
        assert rounds <= 5


class TestRows:
    def test_of_more_rows_than_could_be_stored_the_first_count_and_their_source_is_named(self):
        fusion = Fusion(FusionConfig(max_tracks=10))
        rng = np.random.default_rng(1)
        for k in range(3):
            now = T0 + k * 100 * MS
            fusion.ingest(batch("large", k, now, rng.uniform(-1, 1, (1000, 3))))
            update = fusion.update(now)
        assert sorted(update.track_id.tolist()) == list(range(10))
        assert fusion.stats.observations == 30
        assert fusion.stats.refused_rows == 3 * 990
        assert list(fusion.timeline.troubles.lately()["limit"]) == ["large"]
        assert ("large", "limit") in in_words(fusion.timeline.troubles.lately())


class TestSpaces:
    """Two honest sources in one space beside 40 spaces of another one."""

    def run(self, monkeypatch, costs, updates=40):
        """Costs of a grouping of the honest, ns, by its number; one of the others takes 5 ms."""
        fusion, clock, plain = Fusion(FusionConfig()), Clock(), RigidMethod.partition
        self.grouped, self.ages, self.named, honest = [], [], set(), iter(costs)

        def partition(method, window, current, *args):
            clock.ns += next(honest) if len(current) > 3 else 5 * MS
            self.grouped[-1] += len(current) == 3
            return plain(method, window, current, *args)

        monkeypatch.setattr(RigidMethod, "partition", partition)
        fusion.measure(clock)
        for k in range(updates):
            now, expected = T0 + k * 100 * MS, POINTS + np.array([0.02 * k, 0, 0])
            fusion.ingest(batch("left", k, now, expected))
            fusion.ingest(batch("right", k, now, expected))
            for n in range(40):
                ids = np.arange(3, dtype=np.uint64) + 3 * n
                fusion.ingest(batch("many", 40 * k + n, now, POINTS[:3], space=f"s{n}", ids=ids))
            self.grouped.append(0)
            update = fusion.update(now)
            self.named |= set(fusion.timeline.troubles.lately().get("over-budget", ()))
            mine = np.array([one.name != "many" for one in update.sources])[update.track_source]
            places = update.track_position[mine].reshape(2, -1, 3)
            self.ages.append(np.abs(places - expected).max() / 0.02)
        assert fusion.stats.faults == 0
        assert all(one.rejected == {} for name, one in accounts(fusion).items() if name != "many")
        return fusion, update

    def test_many_spaces_of_one_source_are_its_own_cost(self, monkeypatch):
        fusion, update = self.run(monkeypatch, repeat(5 * MS), 20)
        assert max(self.ages) < 1e-3, "the honest space is as of now in every update"
        assert max(self.grouped[1:]) <= 20, "within a period"
        assert len(update.track_id) == 24 + 120, "what waits is listed as it was"
        assert self.named == {"many"}
        assert {space.spec.name for space in fusion._spaces if space.last} == set(fusion.spaces)

    @pytest.mark.parametrize(
        "costs",
        [
            pytest.param([300 if k % 10 == 5 else 10 for k in range(40)], id="now and then"),
            pytest.param([70] * 40, id="a busy machine, on which everything takes long"),
        ],
    )
    def test_who_costs_little_beside_another_is_not_named_when_its_space_has_to_wait(
        self, monkeypatch, costs
    ):
        self.run(monkeypatch, (one * MS for one in costs))
        assert max(self.ages) > 0.99, "it had to wait"
        assert self.named == {"many"}

    def test_who_is_alone_is_named_where_its_spaces_take_too_long(self):
        turns, clock = Turns(Budget(0.6, 100 * MS)), Clock()
        turns.budget.clock, cost = clock, {"a": 50 * MS, "b": 30 * MS}

        def update(name):
            clock.ns += cost[name]

        for k in range(9):
            waiting = turns.take(k * 100 * MS, {"a": {"cam": 1.0}, "b": {"cam": 1.0}}, update)
            assert turns.costly == ({"cam"} if waiting and k else set())
        assert waiting


class Clock:
    """Tells the time that was spent in it."""

    def __init__(self):
        self.ns = 0

    def __call__(self):
        return self.ns

    def spend(self, budget, name, ns):
        with budget.charge({name: 1.0}):
            self.ns += ns


@pytest.mark.parametrize("method", ["comotion", "thesis"])
def test_instants_of_one_batch_count_as_much_as_batches_of_their_own(method):
    packed, single = (Fusion(FusionConfig(method=method)) for _ in range(2))
    rng = np.random.default_rng(1)
    for k in range(30):
        now = T0 + k * 66 * MS
        stamps = now - np.array([40, 20, 0]) * MS
        steps = np.repeat([[0.0], [1.0]], 6, axis=0)
        seen = [POINTS + steps * 0.01 * (3 * k + n) + rng.normal(0, 1e-3, POINTS.shape) for n in range(3)]
        ids, rows = np.tile(np.arange(12, dtype=np.uint64), 3), np.repeat(stamps, 12)
        packed.ingest(batch("a", k, now, np.concatenate(seen), ids=ids, stamps_ns=rows))
        for n, positions in enumerate(seen):
            single.ingest(batch("a", 3 * k + n, int(stamps[n]), positions))
        one, other = packed.update(now), single.update(now)
    assert packed.stats.observations == single.stats.observations
    assert len(set(one.track_hypothesis.tolist())) == 2
    np.testing.assert_array_equal(one.track_hypothesis, other.track_hypothesis)
    unpacked, expected = packed.affinity("world"), single.affinity("world")
    np.testing.assert_allclose(unpacked.matrix, expected.matrix, atol=1e-6)
