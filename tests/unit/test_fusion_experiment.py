"""The fusion experiment: what it records, how it scores, what it says."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion import FusionConfig
from comotion_experiments.fusion import Setup, report, run_experiment, verdict
from comotion_experiments.fusion.recording import Recording, record
from comotion_experiments.fusion.setup import ALL, ALONE_A, ALONE_B, CAMERA_A, CAMERA_B, ROBOT
from comotion_experiments.fusion.study import Outcome, in_time_order
from comotion_experiments.fusion.surface import Surfaces, box_surface
from comotion_schemas import ObservationBatch, TruthBatch, encode
from comotion_sources.workcell import Scene

TINY = Setup(size=(160, 120), rate_a=10, rate_b=5, rate_robot=50, features=60, cover=(0.8, 1.4), duration=2.4)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def recording(cache: Path) -> Recording:
    return record("arm", 0, TINY, cache)


def test_the_sources_have_their_rates_and_camera_a_goes_blind(recording: Recording) -> None:
    def batches(source: str, covered: bool = False) -> list[ObservationBatch]:
        return [m for m in recording.of(source, covered=covered) if isinstance(m, ObservationBatch)]

    assert len(batches(CAMERA_A)) == 24
    assert len(batches(CAMERA_B)) == 12
    assert sum(len(np.unique(b.stamps_ns)) for b in batches(ROBOT)) == 120
    for batch in batches(CAMERA_A, covered=True):
        if 0.8e9 <= batch.stamp_ns < 1.4e9:
            assert not len(batch.ids)
        elif not 1.4e9 <= batch.stamp_ns < 1.6e9:  # corners are looked for now and then only
            assert len(batch.ids)
    assert all(len(batch.ids) for batch in batches(CAMERA_A))
    open_, covered = (batches(CAMERA_A, covered=c)[3] for c in (False, True))
    assert encode(open_) == encode(covered), "before the cover the two are one"


def test_features_are_where_the_truth_says(recording: Recording) -> None:
    """The hand's features of all sources, moved back into its frame, lie on the hand."""
    scene = Scene.named("arm")
    hand, data = scene.object_of("hand"), scene.new_data()
    distances = []
    for source in (CAMERA_A, CAMERA_B, ROBOT):
        objects: dict[int, int] = {}
        for message in recording.of(source, covered=False):
            if isinstance(message, TruthBatch):
                objects.update(zip(message.ids.tolist(), message.objects.tolist(), strict=True))
                continue
            stamps = (
                message.stamps_ns if message.stamps_ns is not None else [message.stamp_ns] * len(message.ids)
            )
            for identity, stamp, point in zip(message.ids.tolist(), stamps, message.positions, strict=True):
                if objects[identity] == hand:
                    scene.place(data, scene.configuration(int(stamp) * 1e-9))
                    body = data.body("hand")
                    distances.append(np.abs((point - body.xpos) @ body.xmat.reshape(3, 3)).max())
    assert len(distances) > 100
    assert np.quantile(distances, 0.95) < 0.28


def test_a_second_recording_comes_from_the_cache(recording: Recording, cache: Path, monkeypatch) -> None:
    from comotion_experiments.fusion import recording as module

    def fail(*_: object) -> None:
        raise AssertionError("rendered again")

    monkeypatch.setattr(module, "_make", fail)
    again = record("arm", 0, TINY, cache)
    assert [encode(m) for m in again.of(CAMERA_A, covered=True)] == [
        encode(m) for m in recording.of(CAMERA_A, covered=True)
    ]
    with pytest.raises(AssertionError, match="rendered again"):
        record("arm", 1, TINY, cache)


def test_messages_are_merged_by_stamp_with_truth_first(recording: Recording) -> None:
    merged = list(in_time_order([recording.of(s, covered=False) for s in (CAMERA_A, CAMERA_B, ROBOT)]))
    stamps = [m.stamp_ns for m in merged if isinstance(m, ObservationBatch)]
    assert stamps == sorted(stamps)
    known: set[tuple[str, int]] = set()
    for message in merged:
        pairs = {(message.source, i) for i in message.ids.tolist()}
        if isinstance(message, TruthBatch):
            known |= pairs
        else:
            assert pairs <= known


def test_surface_samples_lie_on_the_box_and_are_covered_by_features_near_them() -> None:
    points = box_surface(np.array([0.1, 0.05, 0.02]))
    on_face = np.isclose(np.abs(points), (0.1, 0.05, 0.02)).any(axis=1)
    assert on_face.all()
    assert (np.abs(points) <= (0.1000001, 0.0500001, 0.0200001)).all()
    scene = Scene.named("truck")
    surfaces, data, t = Surfaces(scene), scene.new_data(), 6.0
    scene.place(data, scene.configuration(t))
    number, body = scene.object_of("truck"), data.body("truck")
    samples = surfaces.objects[number] @ body.xmat.reshape(3, 3).T + body.xpos
    everywhere = surfaces.covered(t, samples, np.full(len(samples), number))
    assert everywhere == {number: 1.0, scene.object_of("gripper"): 0.0}
    one = surfaces.covered(t, samples[:1], np.array([number]))[number]
    assert 0 < one < 0.1
    assert surfaces.covered(t, samples[:1], np.array([-1]))[number] == 0


def outcome(ids: dict[int, list[int]], nmi_a: list[float] | None = None) -> Outcome:
    count = len(next(iter(ids.values())))
    ones = np.ones(count)
    return Outcome(
        t=np.arange(count, dtype=float),
        nmi=ones,
        nmi_a=ones if nmi_a is None else np.array(nmi_a),
        surface=ones,
        ids={number: np.array(values) for number, values in ids.items()},
    )


def test_ids_are_kept_when_they_stay_and_what_was_not_apart_does_not_count() -> None:
    assert outcome({1: [4, 4, 4, 4], 2: [5, 5, 6, 6]}).kept(1, 4) == pytest.approx((1 + 1 / 3) / 2)
    assert outcome({1: [4, 4, 4, 4], 2: [4, 4, 6, 6], 3: [7, 7, -1, 8]}).kept(1, 4) == pytest.approx(0.5)
    assert np.isnan(outcome({1: [-1, 4, 4, 4]}).kept(1, 4))


def test_means_leave_out_what_could_not_be_scored() -> None:
    one = outcome({1: [1, 1, 1, 1]}, nmi_a=[0.2, np.nan, 0.6, 1.0])
    assert one.mean(one.nmi_a) == pytest.approx(0.6)
    assert one.mean(one.nmi_a, 2, 3) == pytest.approx(0.6)
    assert np.isnan(one.mean(one.nmi_a, 1, 2))


def test_the_experiment_runs_scores_and_reports(cache: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra plot (matplotlib)")
    config = FusionConfig(method="thesis")
    results = run_experiment(["arm"], [0], config, setup=TINY, cache=cache, period=0.3)
    assert len(results.cases) == 7
    both = results.case("arm", covered=True, variant=ALL)
    single = results.case("arm", covered=True, variant=ALONE_A)
    # What A and B cover together is what either covers, and more where they do not see the same.
    assert both.surface()[0] >= single.surface()[0]
    assert both.surface()[0] >= results.case("arm", covered=True, variant=ALONE_B).surface()[0] - 0.02
    blind = both.outcomes[0]
    assert np.isnan(blind.nmi_a[(blind.t > 0.9) & (blind.t < 1.3)]).all()
    said = verdict(results)
    assert said.surface > said.surface_single
    assert report.as_json(results)["cases"][0]["sources"] == [CAMERA_A]
    assert "on average" in report.lines(results)[0]
    assert len(report.table(results).rows) == 7
    page = report.markdown(results, "fusion.png")
    assert page.count("\n| arm |") == 7
    assert report.lines(results)[0] in page
    report.save_picture(tmp_path / "fusion.png", results)
    assert (tmp_path / "fusion.png").read_bytes()[:4] == b"\x89PNG"
