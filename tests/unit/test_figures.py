"""The figures of the thesis: what they are drawn from, which there are, and the page."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra plot (matplotlib)")

from comotion_deploy.cli import run
from comotion_deploy.commands import reproduce_figures
from comotion_experiments.figures import FIGURES, Options, select
from comotion_experiments.figures.colouring import LETTERS, Styles
from comotion_experiments.figures.numbers import format_times, perfect_from, right_at
from comotion_experiments.figures.runs import ViewRequest
from comotion_experiments.figures.study import Study
from comotion_experiments.offline import thesis
from comotion_experiments.plot import unit
from comotion_schemas import UNDETERMINED

CLOSE = ViewRequest((1.0, 5.0, 10.0), trail=2.0, affinity=True)


@pytest.fixture(scope="module")
def study() -> Study:
    return Study(Options(seeds=(0, 1)))


def test_a_take_has_the_curves_of_every_seed_and_the_golden_values(study):
    take = study.simulated("fig4_1", thesis(0.02), period=0.2, close=CLOSE)
    assert take.nmi.shape == take.hypotheses.shape == (2, 50)
    assert np.all(np.diff(take.t) > 0)
    np.testing.assert_allclose(take.t[[4, 49]], [1.0, 10.0])
    assert np.all(take.nmi[:, take.t >= 1.5] == 1.0)
    assert np.all(perfect_from(take) <= 1.5)
    small = study.simulated("fig4_1", thesis(0.005), period=0.2)
    assert small.mean_nmi().mean() == pytest.approx(0.23, abs=0.01)
    assert format_times(perfect_from(small)) == "never"


def test_a_take_is_run_once(study, monkeypatch):
    first = study.simulated("fig4_1", thesis(0.02), period=0.2, close=CLOSE)
    monkeypatch.setattr("comotion_experiments.figures.study.run_seed", None)
    assert study.simulated("fig4_1", thesis(0.02), period=0.2, close=CLOSE) is first


def test_views_show_the_moments_asked_for(study):
    take = study.simulated("fig4_1", thesis(0.02), period=0.2, close=CLOSE)
    for seed in take.seeds:
        assert [view.t for view in seed.views] == pytest.approx(list(CLOSE.times))
        for view in seed.views:
            names = [seed.names[number] for number in view.affinity_objects.tolist()]
            assert names == ["R"] * 40 + ["G"] * 10
            np.testing.assert_array_equal(view.affinity, view.affinity.T)
            assert 0 <= view.affinity.min() <= view.affinity.max() <= 1
            for trail, now in zip(view.trails, view.moment.positions, strict=True):
                np.testing.assert_array_equal(trail[-1], now)
        assert [len(trail) for trail in seed.views[0].trails] == [16] * 50
        assert [len(trail) for trail in seed.views[1].trails] == [31] * 50
    assert right_at(take, 2) == "100 ± 0 %"
    assert seed.main_of("G")[-1] != seed.main_of("R")[-1]


def test_a_hypothesis_has_the_colour_of_the_object_it_matches_and_a_surplus_one_no_circle(study):
    seed = study.simulated("fig4_1", thesis(0.02), period=0.2, close=CLOSE).seeds[0]
    ids = {number: int(ids[-1]) for number, ids in seed.main.items()}
    styles = Styles(seed)
    for number, name in seed.names.items():
        assert styles.of(ids[number]) == (unit(LETTERS[name]), "o")
    surplus = replace(seed, votes={**seed.votes, **{(1000 + k, 0): 1 for k in range(60)}})
    shapes = {Styles(surplus).of(1000 + k) for k in range(60)}
    assert "o" not in {shape for _, shape in shapes}
    assert len(shapes) == 5 * 4
    assert styles.of(UNDETERMINED)[1] == "x"


def test_there_is_every_figure_and_it_can_be_picked():
    assert [f.name for f in FIGURES] == [f"3.{k}" for k in range(3, 7)] + [f"4.{k}" for k in range(1, 12)]
    assert [f.name for f in select(["4.5,3.6", "4.10"])] == ["3.6", "4.5", "4.10"]
    assert len({f.file for f in FIGURES}) == len(FIGURES)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--only", "9.9"), "no figure '9.9'; one of 3.3, 3.4"),
        (("--only", "4.4,"), "no figure ''"),
        (("--seeds", "x"), "seeds 'x'"),
        (("--workcell-seeds", "-1"), "seeds '-1'"),
        (("--set", "method=thesis"), "compare the default method"),
        (("--set", "window=0"), "window"),
        (("--out", __file__), "not a folder"),
        (("nothing",), "No such command"),
    ],
    ids=str,
)
def test_a_wrong_option_is_one_line(capsys, arguments, words):
    assert run(["dev", "reproduce", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert re.fullmatch(r"error: .*\n", captured.err)
    assert words in captured.err


def test_without_the_workcell_its_figures_are_left_out_and_the_page_stands_alone(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(reproduce_figures, "find_spec", lambda name: None)
    out = tmp_path / "new" / "figures"
    arguments = ["--only", "3.6", "--only", "4.6,4.9", "--seeds", "3", "--out", str(out)]
    assert run(["dev", "reproduce", *arguments]) == 0
    said = "figures 4.6, 4.9 are left out; they need the workcell: pip install 'comotion[sim3d]'"
    captured = capsys.readouterr()
    assert said in captured.out
    assert "[1/1] figure 3.6: fig3_6, default method, seed 3" in captured.err
    assert sorted(path.name for path in out.iterdir()) == ["fig3_6.png", "figures.json", "index.html"]
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "Figures 4.6, 4.9 are left out" in page
    assert "<code>comotion dev reproduce --only 3.6 --only 4.6,4.9 --seeds 3</code>" in page
    assert re.findall(r'<h2 id="(fig[^"]*)"', page) == ["fig3_6"]
    # Nothing is loaded from elsewhere.
    assert re.findall(r'(?:src|href)="(.{5})', page) == ["#fig3", "data:"]
    assert not re.search(r"https?:|@import|url\(|<script|<link", page)
    values = json.loads((out / "figures.json").read_text())
    assert values["left_out"] == ["4.6", "4.9"]
    rows = {row["quantity"]: row for row in values["figures"]["3.6"]["numbers"]}
    assert float(rows["affinity of B to Y at t = 4 s"]["thesis"]) < 0.01
    assert float(rows["affinity of B to G at t = 4 s"]["thesis"]) > 0.9
    assert rows["hypotheses at the end"]["default"] == "2"


def test_the_workcell_alone_cannot_be_drawn_without_mujoco(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(reproduce_figures, "find_spec", lambda name: None)
    assert run(["dev", "reproduce", "--only", "4.6", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "error: mujoco is not installed: pip install 'comotion[sim3d]'\n"


def test_a_workcell_scene_is_filmed_once_and_drawn(tmp_path, monkeypatch):
    pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")
    from comotion_experiments.figures import footage, workcell
    from comotion_sources.klt import TrackerConfig

    tiny = footage.FilmSetup((160, 120), 10.0, 1.4, TrackerConfig(max_features=40, respawn_every=5))
    monkeypatch.setattr(footage, "film_setup", lambda study, respawn_every: tiny)
    monkeypatch.setattr(workcell, "film_setup", footage.film_setup)
    shot = replace(workcell.TRUCK, times=(2 / 3, 4 / 3))
    notes: list[str] = []
    study = Study(Options(workcell_seeds=(0,), cache=tmp_path), notes.append)
    drawn = workcell.pictures(shot)(study)
    assert len(drawn.figure.axes) == 3 * len(shot.times)
    assert sum("rendering" in note for note in notes) == 1
    curves = workcell.curves(shot)(study)
    assert list(curves.curves) == [*(f"σ = {s:g} m" for s in workcell.SWITCHES), "default method"]
    assert all(take.nmi.shape == (1, 4) for take in curves.curves.values())
    # A feature is drawn where the camera saw it, which is inside of the picture.
    view = curves.curves["default method"].seeds[0].views[0]
    places = footage.Stills("truck", 0).pixels(view.moment.positions)
    assert len(places) > 10
    assert np.all((places >= 0) & (places < footage.PICTURE))
