"""The parts of a soak: its schedule, what it sees in updates, its accounts and its verdict."""

import random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from comotion_schemas import DecodeError, HypothesisUpdate, Keys, SourceRef, decode
from comotion_tools.processes import Managed, Usage
from comotion_tools.soak import load
from comotion_tools.soak.accounts import audit, moment
from comotion_tools.soak.attacks import ATTACKS, Attacker
from comotion_tools.soak.monitor import Findings, Gap, Monitor
from comotion_tools.soak.report import as_json, lines, violations
from comotion_tools.soak.run import Soak
from comotion_tools.soak.schedule import Fault

from .. import builders


class Recorded:
    """A session that keeps what is put; tokens come and go unseen."""

    def __init__(self) -> None:
        self.puts: list[tuple[str, bytes]] = []

    def put(self, key: str, payload: bytes) -> None:
        self.puts.append((key, payload))

    def liveliness(self) -> SimpleNamespace:
        return SimpleNamespace(declare_token=lambda _key: SimpleNamespace(undeclare=lambda: None))


@pytest.mark.parametrize("name", ATTACKS)
def test_an_attack_is_within_the_limits_of_a_message(name) -> None:
    session = Recorded()
    attacker = Attacker(session, Keys(), random.Random(0))  # type: ignore[arg-type]
    for _ in range(3):
        ATTACKS[name].step(attacker)
    # Only a space whose name cannot be shown is refused, that of the first and the third batch.
    refused = 0
    for _, payload in session.puts:
        try:
            decode(payload)
        except DecodeError as error:
            refused += error.reason == "schema"
    assert refused == 2 * (name == "markup")
    assert attacker.seq >= len(session.puts)


class Scripted:
    """A subscription that has received what it is given."""

    def __init__(self) -> None:
        self.messages: list[tuple[float, object]] = []

    def drain(self) -> list[tuple[float, object]]:
        found, self.messages = self.messages, []
        return found


def update(labels: dict[int, int], *, born_ns: int = 0) -> HypothesisUpdate:
    """An update of source left, whose bodies have the labels."""
    return builders.update(
        np.repeat(list(labels.values()), 10).tolist(),
        sources=[SourceRef(name="left", session="b" * 16)],
        track_id=[load.ID_STEP * body + k for body in labels for k in range(10)],
        hypotheses=[builders.hypothesis(one, born_ns=born_ns) for one in sorted(set(labels.values()))],
    )


def seen(*updates: tuple[float, HypothesisUpdate]) -> Findings:
    source = Scripted()
    source.messages = list(updates)
    monitor = Monitor(source, Scripted(), 0.0)  # type: ignore[arg-type]
    monitor.poll()
    return monitor.findings


class TestMonitor:
    def test_gaps_and_missed_updates_are_counted(self) -> None:
        one = update({0: 1, 1: 2})
        found = seen(*((at, one) for at in (0.0, 0.1, 0.2, 0.8, 0.9)))
        assert found.updates == 5
        assert found.missed == 5
        assert [(gap.at_s, round(gap.seconds, 3)) for gap in found.gaps] == [(0.8, 0.6)]

    def test_a_label_that_changes_for_long_is_a_change_and_a_short_one_is_none(self) -> None:
        first, second = update({0: 1, 1: 2}), update({0: 1, 1: 3})
        stable = [(k / 10, first) for k in range(30)]
        assert seen(*stable, (3.0, second), *((3.1 + k / 10, first) for k in range(30))).changes == []
        assert seen(*stable, *((3.0 + k / 10, second) for k in range(30))).changes == [(5.0, "world 1", 2, 3)]

    def test_an_id_with_another_birth_was_given_out_twice(self) -> None:
        assert seen((0.0, update({0: 5})), (0.1, update({0: 5}, born_ns=7))).reused == [5]


FATES = ("fused", "partly_late", "late", "duplicates", "overflow", "waiting")


def reply(batches: int, lost: int = 0, **fates: int) -> dict[str, Any]:
    """What the service says of source left, and of a hostile one."""
    fates = dict.fromkeys(FATES, 0) | (fates or {"fused": batches})
    mine = {"source": "left", "session": "a", "batches": batches, "lost": lost, "rejected": {}} | fates
    hostile = mine | {"source": "hostile", "lost": 2**31}
    return {"total": mine | {"batches": batches}, "accounts": [mine, hostile]}


class TestAccounts:
    def source(self, tmp_path, session: str, sent: int, repeated: int = 0) -> Managed:
        source = Managed("left", (), tmp_path)
        source.account = {"session": session, "sent": sent, "repeated": repeated}
        return source

    def test_what_was_sent_is_received_or_lost(self, tmp_path) -> None:
        before = moment("s", reply(10), [self.source(tmp_path, "a", 10)])
        after = moment("s", reply(29, 3), [self.source(tmp_path, "a", 30, 2)])
        found = audit(before, after)
        assert found is not None
        assert (found.sent, found.missing, found.is_exact) == (22, 0, True)
        late = audit(before, moment("s", reply(28, 3), [self.source(tmp_path, "a", 30, 2)]))
        assert late is not None
        assert late.missing == 1


def usage(memory_mb: float, descriptors: int = 20) -> Usage:
    return Usage(memory_mb, descriptors, 10, 1000)


class TestVerdict:
    def test_a_clean_soak_has_no_violation(self) -> None:
        soak = Soak(seconds=60, usage={"service": [(k, 1, usage(300)) for k in range(40)]})
        assert violations(soak, 1.0) == []
        assert "no violation" in lines(as_json(soak, 0, 1.0))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"usage": {"service": [(k, 1, usage(300 + 10 * k)) for k in range(40)]}}, "memory grew"),
            ({"usage": {"router": [(k, 1, usage(300, k)) for k in range(40)]}}, "descriptors grew"),
            ({"ended": {"viewer": [1]}}, "viewer has ended by itself, status 1"),
            ({"findings": Findings(gaps=[Gap(30.0, 2.0)])}, "no update for 2.0 s (no fault)"),
            ({"findings": Findings(changes=[(30.0, "world 1", 2, 3)])}, "world 1 changed from 2 to 3"),
            ({"findings": Findings(reused=[7])}, "7 was given out twice"),
        ],
    )
    def test_what_must_not_be_is_said(self, change, words) -> None:
        found = violations(Soak(seconds=60, **change), 1.0)
        assert len(found) == 1
        assert words in found[0]

    @pytest.mark.parametrize(
        ("most", "kept", "said"),
        [
            (700, 340, []),
            (900, 340, ["memory reached 900 MB"]),
            (700, 380, ["memory was 300 MB, and 380 after the attack at 35 s"]),
        ],
    )
    def test_what_an_attack_takes_is_bounded_and_given_back(self, most, kept, said) -> None:
        """The attack ends at 45 s; 25 s later little of it is left."""
        samples = [(k, 1, usage(300 if k < 40 else most if k < 69 else kept)) for k in range(90)]
        attacked = Fault(35.0, "hostile", "hostile", 10.0)
        found = violations(Soak(faults=[(35.0, attacked)], usage={"service": samples}), 1.0)
        assert [text.partition(": ")[2] for text in found if "grew" not in text] == said

    def test_what_each_attack_leaves_adds_up(self) -> None:
        samples = [(k, 1, usage(300 + 40 * (k > 20) + 40 * (k > 60))) for k in range(100)]
        attacks = [(at_s, Fault(at_s, "hostile", "hostile", 2.0)) for at_s in (20.0, 60.0)]
        found = violations(Soak(faults=attacks, usage={"service": samples}), 1.0)
        assert [text.partition(": ")[2] for text in found] == [
            "memory was 300 MB, and 380 after the attack at 60 s"
        ]

    def test_a_leak_between_attacks_is_said(self) -> None:
        samples = [(k, 1, usage(300 + 10 * max(k - 60, 0))) for k in range(120)]
        soak = Soak(faults=[(20.0, Fault(20.0, "hostile", "hostile", 10.0))], usage={"service": samples})
        assert any("memory grew" in text for text in violations(soak, 1.0))

    def test_gaps_of_a_killed_service_are_excused_and_those_of_a_killed_viewer_are_not(self) -> None:
        for target, count in (("service", 0), ("viewer", 1)):
            soak = Soak(
                faults=[(28.0, Fault(28.0, "kill", target))], findings=Findings(gaps=[Gap(30.0, 2.0)])
            )
            assert len(violations(soak, 1.0)) == count
