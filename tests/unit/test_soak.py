"""The parts of a soak: its schedule, what it sees in updates, its accounts and its verdict."""

from types import SimpleNamespace

import numpy as np
import pytest

from comotion_schemas import SourceRef
from comotion_tools.processes import Managed, Usage
from comotion_tools.soak import load
from comotion_tools.soak.monitor import Findings, Gap, Monitor, audit, moment
from comotion_tools.soak.report import as_json, lines, violations
from comotion_tools.soak.run import Soak
from comotion_tools.soak.schedule import Fault

from .. import builders


def update(labels, born_ns=0):
    """An update of source left, whose bodies have the labels."""
    return builders.update(
        np.repeat(list(labels.values()), 10).tolist(),
        sources=[SourceRef(name="left", session="b" * 16)],
        track_id=[load.ID_STEP * body + k for body in labels for k in range(10)],
        hypotheses=[builders.hypothesis(one, born_ns=born_ns) for one in sorted(set(labels.values()))],
    )


def seen(*updates):
    """Findings of a monitor that has received (time in s, update)."""
    monitor = Monitor(*(SimpleNamespace(drain=lambda got=got: got) for got in (updates, ())), 0.0)
    monitor.poll()
    return monitor.findings


def test_gaps_and_missed_updates_are_counted():
    findings = seen(*((at, update({0: 1, 1: 2})) for at in (0.0, 0.1, 0.2, 0.8, 0.9)))
    assert (findings.updates, findings.missed) == (5, 5)
    assert [(gap.at_s, round(gap.seconds, 3)) for gap in findings.gaps] == [(0.8, 0.6)]


def test_a_label_that_changes_for_long_is_a_change_and_a_birth_that_changes_is_an_id_given_out_twice():
    first, second = update({0: 1, 1: 2}), update({0: 1, 1: 3})
    stable = [(k / 10, first) for k in range(30)]
    assert seen(*stable, (3.0, second), *((3.1 + k / 10, first) for k in range(30))).changes == []
    assert seen(*stable, *((3.0 + k / 10, second) for k in range(30))).changes == [(5.0, "world 1", 2, 3)]
    assert seen((0.0, update({0: 5})), (0.1, update({0: 5}, born_ns=7))).reused == [5]


def counted(folder, batches, lost, sent, repeated=0):
    """The accounts of a moment: what source left says, and the service of it and of a hostile one."""
    source = Managed("left", (), folder)
    source.account = {"session": "a", "sent": sent, "repeated": repeated}
    fates = dict.fromkeys(("partly_late", "late", "duplicates", "overflow", "waiting"), 0) | {
        "fused": batches
    }
    mine = {"source": "left", "session": "a", "batches": batches, "lost": lost, "rejected": {}} | fates
    reply = {"total": mine, "accounts": [mine, mine | {"source": "hostile", "lost": 2**31}]}
    return moment("s", reply, [source])


def test_what_was_sent_is_received_or_lost(tmp_path):
    before = counted(tmp_path, 10, 0, sent=10)
    account = audit(before, counted(tmp_path, 29, 3, sent=30, repeated=2))
    assert (account.sent, account.missing, account.is_exact) == (22, 0, True)
    assert audit(before, counted(tmp_path, 28, 3, sent=30, repeated=2)).missing == 1


def held(memory_mb, *faults, descriptors=lambda k: 20):
    """A soak in which the service held so much memory at each second."""
    samples = [(k, 1, Usage(mb, descriptors(k), 10, 1000)) for k, mb in enumerate(memory_mb)]
    return {"usage": {"service": samples}, "faults": [(one.at_s, one) for one in faults]}


def attack(at_s, seconds):
    return Fault(at_s, "hostile", "hostile", seconds)


def gap_after(*faults):
    return {"findings": Findings(gaps=[Gap(30.0, 2.0)]), "faults": [(one.at_s, one) for one in faults]}


BEFORE, DURING, AFTER = [300] * 40, range(29), range(21)
# What a soak has found, and words of each violation.
VERDICTS = {
    "clean": (held([300] * 40), []),
    "a leak": (held(300 + 10 * k for k in range(40)), ["memory grew"]),
    "descriptors": (held([300] * 40, descriptors=lambda k: k), ["descriptors grew"]),
    "an end": ({"ended": {"viewer": [1]}}, ["viewer has ended by itself, status 1"]),
    "a gap": (gap_after(), ["no update for 2.0 s (no fault)"]),
    "a gap of a killed service": (gap_after(Fault(28, "kill", "service"), Fault(29.5, "kill", "left")), []),
    "a gap of a killed viewer": (gap_after(Fault(28.0, "kill", "viewer")), ["no update for 2.0 s"]),
    "a change": ({"findings": Findings(changes=[(30.0, "world 1", 2, 3)])}, ["world 1 changed from 2 to 3"]),
    "an id twice": ({"findings": Findings(reused=[7])}, ["7 was given out twice"]),
    # The attack ends at 45 s; 25 s later much of what it took is left.
    "kept": (
        held([*BEFORE, *(700 for _ in DURING), *(380 for _ in AFTER)], attack(35, 10)),
        ["memory grew from 300 to 380 MB"],
    ),
}


@pytest.mark.parametrize(("findings", "expected"), VERDICTS.values(), ids=VERDICTS)
def test_each_violation_has_a_line(findings, expected):
    soak = Soak(seconds=60, **findings)
    texts = violations(soak, 1.0)
    assert len(texts) == len(expected)
    assert all(words in text for words, text in zip(expected, texts, strict=True))
    assert ("no violation" in lines(as_json(soak, 0, 1.0))) == (not expected)
