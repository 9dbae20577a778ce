"""Stress scenes and images: deterministic, true to what they say; the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_experiments.stress import FAMILIES
from comotion_experiments.stress.observe import EPOCH_NS, messages_of
from comotion_experiments.stress.scene import Scene
from comotion_schemas import encode

SHORT = {
    "rest": {"duration": 22.0},
    "stop_and_go_10min": {"duration": 40.0},
    "ten_minutes": {"duration": 70.0},
    "late_start": {"phases": 2, "duration": 2.0},
    "late_start_rough": {"phases": 2, "duration": 2.0},
}


SCENES = [name for name, family in FAMILIES.items() if not family.of_images]


def scenes_of(name: str) -> list[Scene]:
    return FAMILIES[name].scenes(2, **SHORT.get(name, {}))


@pytest.mark.parametrize("name", SCENES[::3])
def test_a_family_gives_the_same_messages_twice_and_every_feature_has_a_truth(name: str) -> None:
    scene, same = (scenes_of(name)[-1] for _ in range(2))
    first, again = messages_of(scene), messages_of(same)
    assert [encode(a.batch) for a in first.batches] == [encode(a.batch) for a in again.batches]
    assert first.batches
    objects = {
        (truth.source, truth.session, identity): number
        for truth in first.truth
        for identity, number in zip(truth.ids.tolist(), truth.objects.tolist(), strict=True)
    }
    for arrived in first.batches:
        batch = arrived.batch
        for identity in batch.ids.tolist():
            assert 0 <= objects[batch.source, batch.session, identity] < len(scene.bodies)
    begin, end = first.batches[0].now_ns - EPOCH_NS, first.batches[-1].now_ns - EPOCH_NS
    assert scene.start <= begin / 1e9 <= scene.start + 0.2
    assert scene.duration - 0.2 <= end / 1e9 <= scene.duration
    other = FAMILIES[name].scenes(0, **SHORT.get(name, {}))[0]
    assert not np.array_equal(scene.lives.local[:10], other.lives.local[:10]), "another seed, another scene"


def test_the_command_writes_a_page_and_a_picture(tmp_path, capsys, monkeypatch) -> None:
    out = tmp_path / "out"
    short = replace(FAMILIES["late_movers"], parameters={"first": 1.0, "every": 1.0, "duration": 4.0})
    monkeypatch.setitem(FAMILIES, "late_movers", short)
    options = ["--family", "late_movers", "--family", "image_planar", "--seeds", "2", "--jobs", "1", "--json"]
    assert run(["dev", "reproduce", "stress", *options, "--out", str(out)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [(row["family"], row["seed"], len(row["errors"])) for row in shown["images"]] == [
        ("image_planar", 2, 6)
    ]
    assert [(r["family"], r["method"], r["seed"]) for r in shown["runs"]] == [
        ("late_movers", "comotion", 2),
        ("late_movers", "thesis", 2),
    ]
    page = (out / "stress.md").read_text()
    assert "| `late_movers` | start one after the other |" in page
    assert "| `image_planar` | bodies and background are planes |" in page
    assert "not all odd" in " ".join(page.split())
    assert (out / "images" / "stress.png").stat().st_size > 1000
