"""The simulator: the scenes are what the method's table says, and their truth holds."""

from collections import defaultdict

import numpy as np
import pytest

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_sources.errors import SceneError
from comotion_sources.simulator import Simulation, batches, load_scene, scene_names, simulate

EPOCH_NS = 1_700_000_000_000_000_000

SCENES = {
    # name: (features at the start by object, duration, features in all)
    "fig3_3": ({"R": 20, "G": 20, "P": 20, "Y": 20, "B": 20}, 9.0, 100),
    "fig3_6": ({"R": 3, "G": 3, "P": 3, "Y": 3, "B": 3}, 4.0, 15),
    "fig4_1": ({"R": 40, "G": 10}, 10.0, 50),
    "fig4_3": ({"R": 40, "G": 10}, 12.67, 50),
    "fig4_4": ({"R": 20, "G": 10, "P": 10}, 8.0, 64),
    "3d_2": ({"background": 20, "body 1": 12}, 12.0, 62),
    "3d_3": ({"background": 20, "body 1": 12, "body 2": 12}, 12.0, 84),
    "3d_4": ({"background": 20, "body 1": 12, "body 2": 12, "body 3": 12}, 12.0, 106),
    "3d_5": ({"background": 20, "body 1": 8, "body 2": 8, "body 3": 8, "body 4": 8}, 12.0, 112),
    "3d_async": ({"background": 20, "body 1": 12, "body 2": 12}, 12.0, 84),
    "3d_camera": ({"background": 20, "body 1": 12, "body 2": 12}, 12.0, 84),
    "3d_gaps": ({"background": 20, "body 1": 12, "body 2": 12}, 12.0, 84),
    "3d_late": ({"background": 20, "body 1": 12, "body 2": 12}, 14.0, 92),
    "3d_outliers": (
        {"background": 20, "body 1": 12, "body 2": 12, "outlier 1": 1, "outlier 2": 1},
        12.0,
        86,
    ),
    "3d_pose": ({"background": 20, "body 1": 13, "body 2": 13}, 12.0, 86),
    "3d_rotation": ({"background": 20, "body 1": 12, "body 2": 12}, 12.0, 84),
    "3d_static": ({"background": 44}, 12.0, 84),
}


def run(name, **options):
    return Simulation(load_scene(name), **options)


def tracks(frames):
    """Positions by id, as {frame number: position}."""
    result = defaultdict(dict)
    for number, frame in enumerate(frames):
        for identity, position in zip(frame.ids.tolist(), frame.positions, strict=True):
            result[identity][number] = position
    return result


def objects_of(frames):
    return {i: o for f in frames for i, o in zip(f.ids.tolist(), f.objects.tolist(), strict=True)}


def test_every_tabulated_scene_ships():
    assert scene_names() == sorted(SCENES)


@pytest.mark.parametrize("name", sorted(SCENES))
def test_scene_has_the_tabulated_features(name):
    counts, duration, total = SCENES[name]
    simulation = run(name)
    frames = list(simulation)
    first = frames[0]
    names = simulation.object_names
    present = objects_of(frames)
    born_at_start = {i: o for i, o in present.items() if i < sum(counts.values())}
    found = {n: sum(o == k for o in born_at_start.values()) for k, n in names.items()}
    assert found == counts
    assert len(present) == total
    assert first.t == 0.0
    assert frames[-1].t == pytest.approx(duration, abs=1 / 15)
    assert len(frames) == len(simulation)
    # One name for both would be refused by a service that has seen the other.
    assert simulation.spec.space == ("plane" if simulation.spec.dim == 2 else "world")
    assert simulation.spec.unit == "m"


def test_key_states_are_reached_and_joined_by_lines():
    frames = list(run("fig4_1", noise=0.0))
    path = tracks(frames)
    green = [i for i, o in objects_of(frames).items() if o == 1]
    for identity in green:
        moved = [path[identity][k] - path[identity][0] for k in range(len(frames))]
        expected = [[0.07 * frame.t, 0.0] for frame in frames]
        np.testing.assert_allclose(moved, expected, atol=1e-12)


def test_objects_of_figure_3_3_start_one_second_after_another():
    simulation = run("fig3_3")
    times = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
    x = [simulation.poses(body, times).translations[:, 0] for body in range(1, 5)]
    np.testing.assert_allclose(x[0], [0.1, 0.2, 0.3, 0.4, 1.0])
    np.testing.assert_allclose(x[3], [0.1, 0.1, 0.1, 0.1, 0.7])


def test_figure_4_4_spins_there_and_back():
    angle = [
        np.arctan2(pose[1, 0], pose[0, 0])
        for pose in run("fig4_4").poses(1, np.array([0.0, 8 / 3, 16 / 3, 8.0])).rotations
    ]
    np.testing.assert_allclose(angle, [0.0, np.pi / 2, -np.pi / 2, np.pi / 2], atol=1e-12)


def test_a_fifth_of_each_body_is_replaced_every_two_seconds():
    frames = list(run("fig4_4"))
    objects = objects_of(frames)
    ended = {frame.t: frame.ended for frame in frames if frame.ended.size}
    assert list(ended) == [2.0, 4.0, 6.0]
    for t, identities in ended.items():
        assert np.bincount([objects[i] for i in identities.tolist()]).tolist() == [4, 2, 2]
        after = [frame for frame in frames if frame.t >= t]
        assert not np.isin(identities, np.concatenate([frame.ids for frame in after])).any()
    for frame in frames:
        assert np.bincount(frame.objects).tolist() == [20, 10, 10]


def test_noise_is_gaussian_of_the_stated_size_and_scaled_by_the_factor():
    exact = list(run("fig4_1", noise=0.0))
    for factor in (1.0, 2.0):
        noisy = list(run("fig4_1", noise=factor))
        error = np.stack([a.positions - b.positions for a, b in zip(noisy, exact, strict=True)])
        background = exact[0].objects == 0
        np.testing.assert_allclose(error[:, background].std(), 0.01 * factor, rtol=0.03)
        np.testing.assert_allclose(error[:, ~background].std(), 0.005 * factor, rtol=0.05)
        np.testing.assert_allclose(noisy[0].sigma[background], 0.01 * factor)


def test_the_same_seed_gives_the_same_frames_and_another_seed_others():
    def bits(seed):
        return [frame.positions.tobytes() for frame in run("3d_outliers", seed=seed)]

    assert bits(1) == bits(1)
    assert bits(1) != bits(2)


def test_sources_of_different_rates_are_in_phase_with_one_world():
    start = tracks(run("fig4_1", noise=0.0))
    for source in simulate(load_scene("fig4_1"), noise=0.0, rates=[15, 30, 100]):
        for frame in source:
            for identity, seen, o in zip(
                frame.ids.tolist(), frame.positions, frame.objects.tolist(), strict=True
            ):
                expected = start[identity][0] + (np.array([0.07 * frame.t, 0.0]) if o == 1 else 0.0)
                np.testing.assert_allclose(seen, expected, atol=1e-12)


def test_respawns_happen_at_the_same_time_in_every_source():
    whole = {i for f in run("fig4_4", seed=4) for i in f.ended.tolist()}
    seen = set()
    for source in simulate(load_scene("fig4_4"), seed=4, rates=[15, 30, 100]):
        for frame in source:
            seen |= set(frame.ended.tolist())
            if frame.ended.size:
                assert 0.0 <= frame.t % 2.0 < 1 / source.rate
    assert seen == whole


def test_time_scale_plays_the_scene_faster():
    normal, fast = run("fig4_1", noise=0.0, rate=30.0), run("fig4_1", noise=0.0, time_scale=2.0)
    assert fast.duration == 5.0
    assert len(fast) == 76
    for a, b in zip(list(normal)[::4], fast, strict=False):
        assert b.t == pytest.approx(a.t / 2)
        np.testing.assert_allclose(a.positions, b.positions, atol=1e-12)


def test_occluded_features_come_back_under_their_id():
    frames = list(run("3d_gaps", rate=100.0))
    period = 1 / 100
    gaps = []
    for path in tracks(frames).values():
        missing = np.diff(sorted(path)) - 1
        gaps += (missing[missing > 0] * period).tolist()
        assert np.count_nonzero(missing) <= 1
    assert len(gaps) > 15
    assert min(gaps) > 0.3 - 2 * period
    assert max(gaps) < 1.5 + 2 * period


def test_a_moving_camera_moves_everything_and_the_poses_tell_how():
    simulation = run("3d_camera", noise=0.0)
    frames = list(simulation)
    background = frames[0].objects == 0
    shift = tracks(frames)
    identity = int(frames[0].ids[background][0])
    poses = simulation.poses(0, np.array([frame.t for frame in frames]))
    local = poses.rotations[0].T @ (shift[identity][0] - poses.translations[0])
    for number, position in shift[identity].items():
        predicted = poses.rotations[number] @ local + poses.translations[number]
        np.testing.assert_allclose(position, predicted, atol=1e-12)
    assert np.ptp(poses.translations, axis=0).max() > 0.1


def test_the_late_mover_rests_until_ten_seconds():
    translations = run("3d_late").poses(2, np.array([0.0, 5.0, 10.0, 11.0])).translations
    np.testing.assert_allclose(translations[:3], np.tile(translations[0], (3, 1)), atol=1e-12)
    assert np.linalg.norm(translations[3] - translations[2]) > 0.01


def test_nothing_moves_in_the_static_scene():
    for path in tracks(run("3d_static", noise=0.0)).values():
        np.testing.assert_array_equal(np.ptp(np.array(list(path.values())), axis=0), 0.0)


def test_pose_features_turn_with_their_body():
    simulation = run("3d_pose", noise=0.0)
    for frame in list(simulation)[::30]:
        posed = np.isfinite(frame.quaternions).all(axis=1)
        assert posed.sum() == 2
        for row in np.flatnonzero(posed):
            x, y, z, w = frame.quaternions[row]
            body = simulation.poses(int(frame.objects[row]), np.array([frame.t])).rotations[0]
            np.testing.assert_allclose(np.trace(body), 4 * w * w - 1, atol=1e-12)
            np.testing.assert_allclose(body @ [x, y, z], [x, y, z], atol=1e-12)


def test_batches_tell_the_truth_of_a_feature_before_its_first_observation():
    spec = load_scene("fig4_4")
    known, seq, last = defaultdict(dict), defaultdict(int), 0
    for message in batches(simulate(spec, rates=[15, 30, 100]), epoch_ns=EPOCH_NS):
        assert encode(decode(encode(message))) == encode(message)
        if isinstance(message, TruthBatch):
            known[message.source].update(zip(message.ids.tolist(), message.objects.tolist(), strict=True))
            continue
        assert isinstance(message, ObservationBatch)
        assert set(message.ids.tolist()) <= known[message.source].keys()
        assert message.stamp_ns >= max(last, EPOCH_NS)
        assert message.seq == seq[message.source]
        seq[message.source] += 1
        last = message.stamp_ns
    assert dict(seq) == {"simulator-1": 121, "simulator-2": 240, "simulator-3": 800}
    whole = objects_of(Simulation(spec))
    assert {i: o for part in known.values() for i, o in part.items()} == whole


def test_noise_is_published_on_demand_and_only_where_there_is_some():
    def sigmas(name, **options):
        messages = batches(run(name, **options), publish_sigma=True)
        return next(m.sigma for m in messages if isinstance(m, ObservationBatch))

    np.testing.assert_allclose(sigmas("fig4_1")[[0, -1]], [0.01, 0.005])
    assert sigmas("3d_2") == 0.003
    assert sigmas("fig3_6") is None
    assert next(m for m in batches(run("3d_2")) if isinstance(m, ObservationBatch)).sigma is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rate": 0.0}, "rate 0"),
        ({"rate": float("nan")}, "rate nan"),
        ({"noise": -1.0}, "noise factor -1"),
        ({"time_scale": 0.0}, "time scale 0"),
        ({"part": 3, "parts": 3}, "part 4 of 3"),
        ({"seed": -1}, "seed -1"),
    ],
)
def test_bad_arguments_are_refused(options, words):
    with pytest.raises(SceneError, match=words):
        run("fig4_1", **options)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("dim = 2", "dim = 4", "dim"),
        ("dim = 2", "dim =", "not valid TOML"),
        ("dim = 2", "dim = 3", "size needs 3 numbers"),
        ("features = 40", "features = -1", r"bodies\.0\.features"),
        ("sigma = 0.01", "sigma = 0.01\nsgima = 1.0", r"bodies\.0\.sgima"),
        ('kind = "rest"', 'kind = "walk"', "walk"),
        ("[10.0, 0.85, 0.5, 0.0]", "[0.0, 0.85, 0.5, 0.0]", "times of the states must increase"),
        ("[10.0, 0.85, 0.5, 0.0]", "[10.0, 0.85, 0.5]", "a state needs 4 numbers"),
        ('"G"', '"R"', "two bodies have the same name"),
    ],
)
def test_a_malformed_scene_is_one_clear_line(tmp_path, old, new, words):
    from importlib import resources

    text = (resources.files("comotion_sources") / "scenes/fig4_1.toml").read_text()
    assert old in text
    path = tmp_path / "scene.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)


def test_a_scene_that_does_not_exist_names_those_that_do(tmp_path):
    with pytest.raises(SceneError, match=r"no scene 'fig9'.*fig4_4"):
        load_scene("fig9")
    (tmp_path / "x").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="not a text file"):
        load_scene(tmp_path / "x")
