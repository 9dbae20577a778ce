"""The workcell: motion, truth, images that a tracker can work with, and files others can read."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_experiments.segment import SegmentOptions, segment
from comotion_schemas import JointStates
from comotion_sources.cameras.tum import TumFolder
from comotion_sources.cameras.types import CameraError
from comotion_sources.errors import SceneError

mujoco = pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion_sources.frames import AMBIGUOUS  # noqa: E402
from comotion_sources.klt import Tracker, TrackerConfig  # noqa: E402
from comotion_sources.poses import read_trajectory  # noqa: E402
from comotion_sources.workcell import Scene, Viewpoint, open_camera, scene_names  # noqa: E402
from comotion_sources.workcell.atlas import Atlas, build_atlas  # noqa: E402
from comotion_sources.workcell.camera import WorkcellCamera, parse  # noqa: E402
from comotion_sources.workcell.history import JointHistory  # noqa: E402
from comotion_sources.workcell.process import joint_states  # noqa: E402
from comotion_sources.workcell.render import MOVING, Renderer, multi_ray  # noqa: E402
from comotion_sources.workcell.scene import BACKGROUND  # noqa: E402
from comotion_sources.workcell.sensor import SensorNoise  # noqa: E402
from comotion_sources.workcell.tum import write_tum  # noqa: E402
from comotion_sources.workcell.viewpoint import object_map  # noqa: E402

SMALL = (160, 120)


@pytest.fixture(scope="module")
def truck() -> Scene:
    return Scene.named("truck")


@pytest.fixture(scope="module")
def atlas(truck: Scene) -> Atlas:
    return build_atlas(truck.model, 0)


@pytest.fixture(scope="module")
def view(truck: Scene, atlas: Atlas) -> Viewpoint:
    return Viewpoint(truck, "a", (320, 240), atlas=atlas)


@pytest.fixture(scope="module")
def renderer(truck: Scene, view: Viewpoint, atlas: Atlas) -> Renderer:
    return Renderer(truck, view.intrinsics, view.extrinsics, atlas)


def body_pose(scene: Scene, name: str, t: float) -> tuple[np.ndarray, np.ndarray]:
    data = scene.new_data()
    scene.place(data, scene.configuration(t))
    body = scene.model.body(name).id
    return data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy()


@pytest.mark.parametrize("name", scene_names())
def test_motion_repeats_without_a_jump_and_moves_every_object(name: str) -> None:
    scene = Scene.named(name)
    assert np.allclose(scene.configuration(0.0), scene.configuration(scene.period))
    states = np.array([scene.configuration(t) for t in np.arange(0, scene.period, 0.1)])
    speed = np.abs(np.diff(states, axis=0, append=states[:1])) / 0.1
    wheels = np.array([joint.startswith("wheel") for joint in scene.joints])
    assert (speed.max(axis=0) > 0.01).all(), "a joint never moves"
    assert speed[:, ~wheels].max() < 1.0, "a body jumps"


def test_the_scenes_of_the_experiment_are_there_with_their_clutter() -> None:
    assert set(scene_names()) == {
        "eye-in-hand",
        *(s + v for s in ("truck", "truck-tower", "shelf", "arm") for v in ("", "-clutter")),
    }
    bare, full = Scene.named("shelf"), Scene.named("shelf-clutter")
    assert full.model.ngeom > bare.model.ngeom
    assert bare.shadow is None
    assert full.shadow is not None
    assert full.objects == bare.objects


def test_the_gripper_pulls_the_truck_and_lets_it_go(truck: Scene) -> None:
    """While it pulls, the fingers stay at the end of the draw-bar; before, they are away from it."""

    def gap(t: float) -> float:
        turn, place = body_pose(truck, "truck", t)
        return float(np.linalg.norm((place + turn @ (-0.2, 0, 0) - body_pose(truck, "gripper", t)[1])[:2]))

    assert max(gap(t) for t in np.arange(3, 16, 0.5)) < 0.04
    assert gap(0.5) > 0.15


def test_wheels_roll_on_the_table(truck: Scene) -> None:
    before, after = (dict(zip(truck.joints, truck.configuration(t), strict=True)) for t in (3.0, 9.0))
    way = after["truck_x"] - before["truck_x"]
    assert after["wheel_fl"] - before["wheel_fl"] == pytest.approx(way / 0.03, rel=1e-3)


def test_what_is_fixed_to_an_object_belongs_to_it_and_wheels_are_not_scored() -> None:
    arm, truck = Scene.named("arm"), Scene.named("truck")
    geoms = {arm.model.geom(i).name: int(arm.geom_objects[i]) for i in range(arm.model.ngeom)}
    assert geoms["carried_carton"] == geoms["hand_palm"] == arm.object_of("hand")
    assert geoms["table"] == BACKGROUND
    assert truck.object_of("wheel_fl") == AMBIGUOUS


def test_seeds_vary_timing_and_cameras_but_not_the_way(truck: Scene) -> None:
    other = Scene.named("truck", 3)
    states = [np.array([s.configuration(t) for t in np.arange(0, 18, 0.05)]) for s in (truck, other)]
    assert np.abs(states[0] - states[1]).max() > 0.01
    column = truck.joints.index("truck_x")
    for low_high in (np.min, np.max):
        assert low_high(states[0][:, column]) == pytest.approx(low_high(states[1][:, column]), abs=1e-3)


def test_the_same_frame_comes_out_bit_for_bit_in_another_process_image(truck: Scene, view: Viewpoint) -> None:
    again = Viewpoint(Scene.named("truck"), "a", (320, 240))
    first, second = (v.frame(truck.configuration(5.0), 5_000_000_000) for v in (view, again))
    assert np.array_equal(first.image, second.image)
    assert np.array_equal(first.depth, second.depth)
    assert not np.array_equal(first.depth, view.frame(truck.configuration(5.0), 5_000_000_001).depth)


def test_depth_and_geoms_agree_with_single_rays_of_mujoco(
    truck: Scene, view: Viewpoint, renderer: Renderer
) -> None:
    """What cannot move is cast once and moving bodies on top: nothing may get lost between the two."""
    for t in (5.0, 10.0):
        ideal = renderer.render(truck.configuration(t))
        data = truck.new_data()
        truck.place(data, truck.configuration(t))
        rng = np.random.default_rng(1)
        moving = np.argwhere(truck.model.geom_group[ideal.geoms] == MOVING)
        pixels = np.concatenate(
            [rng.integers(0, (240, 320), (150, 2)), moving[rng.integers(0, len(moving), 150)]]
        )
        for v, u in pixels:
            ray = view.extrinsics.rotation @ view.intrinsics.rays([[u, v]])[0]
            geom = np.zeros(1, np.int32)
            distance = mujoco.mj_ray(
                truck.model, data, view.extrinsics.translation, ray, None, 1, -1, geom, None
            )
            assert ideal.geoms[v, u] == geom[0]
            assert ideal.depth[v, u] == pytest.approx(distance, abs=1e-5)


def test_rays_that_hit_nothing_say_so(truck: Scene) -> None:
    data = truck.new_data()
    geoms, distance = multi_ray(truck.model, data, np.array([0.0, 0, 1]), np.array([[0.0, 0, 1]]), MOVING)
    assert geoms.tolist() == [-1]
    assert distance.tolist() == [0]
    assert len(multi_ray(truck.model, data, np.zeros(3), np.empty((0, 3)), MOVING)[0]) == 0


def test_textures_are_fixed_to_the_bodies(truck: Scene, view: Viewpoint, renderer: Renderer) -> None:
    """A point of the truck looks the same after a metre of travel, up to light and resampling."""
    frames = [renderer.render(truck.configuration(t)) for t in (2.0, 6.2)]
    poses = [body_pose(truck, "truck", t) for t in (2.0, 6.2)]
    assert np.linalg.norm(poses[0][1] - poses[1][1]) > 0.2
    geom = truck.model.geom("truck_bed").id
    rows = np.argwhere(frames[0].geoms == geom)
    depth = frames[0].depth[rows[:, 0], rows[:, 1]]
    world = view.extrinsics.apply(view.intrinsics.lift(rows[:, ::-1], depth))
    body = (world - poses[0][1]) @ poses[0][0]
    moved = view.extrinsics.inverse().apply(body @ poses[1][0].T + poses[1][1])
    there = np.rint(view.intrinsics.project(moved)).astype(int)
    same = frames[1].geoms[there[:, 1], there[:, 0]] == geom
    assert same.mean() > 0.8
    grey = [
        cv2.GaussianBlur(cv2.cvtColor(f.image, cv2.COLOR_BGR2GRAY), (0, 0), 1.5).astype(float) for f in frames
    ]
    before = grey[0][rows[same][:, 0], rows[same][:, 1]]
    after = grey[1][there[same][:, 1], there[same][:, 0]]
    assert np.corrcoef(before, after)[0, 1] > 0.85


def test_depth_noise_grows_with_the_square_of_the_distance(
    truck: Scene, view: Viewpoint, renderer: Renderer
) -> None:
    ideal = renderer.render(truck.configuration(0.0))
    frames = [view.frame(truck.configuration(0.0), stamp).depth for stamp in range(20)]
    stack = np.where(np.array(frames) > 0, frames, np.nan)
    error = stack - ideal.depth
    for low, high in ((0.7, 0.9), (1.2, 1.5), (1.8, 2.2)):
        band = (ideal.depth > low) & (ideal.depth < high)
        if band.sum() < 500:
            continue
        expected = SensorNoise().depth_per_m2 * np.median(ideal.depth[band]) ** 2
        spread = np.nanmedian(np.abs(error[:, band])) * 1.4826
        assert spread == pytest.approx(expected, rel=0.25)


def test_depth_drops_out_at_edges_more_than_elsewhere(truck: Scene, view: Viewpoint) -> None:
    frame = view.frame(truck.configuration(5.0), 1)
    assert frame.depth is not None
    outline = frame.objects == AMBIGUOUS
    assert np.mean(frame.depth[outline] == 0) > 0.2
    assert np.mean(frame.depth[~outline] == 0) < 0.06


def test_truth_is_unknown_on_outlines_only() -> None:
    geoms = np.zeros((5, 6), np.int32)
    geoms[:, 3:] = 1
    assert object_map(np.array([0, 2], np.int32), geoms)[2].tolist() == [0, 0, -1, -1, 2, 2]
    assert object_map(np.array([0, 0], np.int32), geoms)[2].tolist() == [0] * 6


@pytest.mark.parametrize("name", ["truck-clutter", "arm"])
def test_klt_features_stay_on_the_body_they_were_born_on(name: str) -> None:
    """After one second 97 % are on their body still, and have drifted less than 5 mm in its frame."""
    scene = Scene.named(name)
    view = Viewpoint(scene, "a", (480, 360))
    tracker = Tracker(TrackerConfig(), view.intrinsics)
    bodies = {number: body for number, body in scene.objects.items() if number}
    start, born, on_body, drift = 5.0, {}, [], []

    def in_body(number: int, t: float, point: np.ndarray) -> np.ndarray:
        turn, place = body_pose(scene, bodies[number], t)
        return (point - place) @ turn

    for index in range(31):
        t = start + index / 30
        frame = view.frame(scene.configuration(t), round(t * 1e9))
        tracks = tracker.step(frame)
        if index not in (0, 30):
            continue
        world = view.extrinsics.apply(tracks.points)
        column, row = np.rint(tracks.pixels).astype(int).T
        objects = frame.objects[row.clip(0, 359), column.clip(0, 479)]
        for identity, point, number in zip(tracks.ids.tolist(), world, objects.tolist(), strict=True):
            if index == 0:
                born[identity] = (number, point)
            elif identity in born and born[identity][0] >= 0:
                first, was = born[identity]
                on_body.append(first == number)
                if first and np.isfinite([*was, *point]).all():
                    drift.append(np.linalg.norm(in_body(first, t, point) - in_body(first, start, was)))
    assert len(on_body) > 100
    assert len(drift) > 5
    assert np.mean(on_body) >= 0.97
    assert np.median(drift) < 0.005


def test_a_camera_not_attached_runs_through_the_scene() -> None:
    camera = open_camera("truck/b?size=160x120&rate=10&duration=0.3&cover=0.1-0.2")
    frames = list(camera)
    assert [f.stamp_ns for f in frames] == [0, 100_000_000, 200_000_000]
    assert [bool(f.depth.any()) for f in frames] == [True, False, True]
    assert frames[1].image.max() < 10
    assert (frames[1].objects == AMBIGUOUS).all()
    assert not camera.live
    assert camera.rate == 10
    assert camera.objects == camera.scene.objects
    camera.close()
    assert list(camera) == []


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("truck", "expected workcell:SCENE/CAMERA"),
        ("nope/a", "no workcell scene 'nope'; one of arm,"),
        ("../truck/a", "no workcell scene"),
        ("truck/z", "truck has no camera 'z'; one of a, b"),
        ("truck/a?colour=red", "unknown option 'colour'"),
        ("truck/a?size=9x9", "size=9x9 is not valid"),
        ("truck/a?rate=nan", "rate=nan is not valid"),
        ("truck/a?cover=3-2", "cover=3-2 is not valid"),
        ("truck/a?seed=-1", "seed=-1 is not valid"),
    ],
)
def test_a_wrong_camera_name_is_one_clear_line(text: str, complaint: str) -> None:
    with pytest.raises(CameraError) as error:
        open_camera(text)
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)


def states(truck: Scene, stamp_ns: int, seq: int = 0, session: str = "0" * 16) -> JointStates:
    return joint_states(truck, stamp_ns, source="workcell", session=session, seq=seq)


def test_joint_history_gives_the_configuration_between_messages(truck: Scene) -> None:
    history = JointHistory(truck.joints)
    assert history.at(0) is None
    for seq, stamp in enumerate(range(4_000_000_000, 5_000_000_000, 5_000_000)):
        history.add(states(truck, stamp, seq))
    wanted = 4_512_345_678
    assert history.at(wanted) == pytest.approx(truck.configuration(wanted * 1e-9), abs=1e-4)
    assert history.at(3_999_999_999) is None
    assert history.at(5_000_000_000) is None


def test_joint_history_ignores_what_is_late_or_of_another_robot_and_restarts(truck: Scene) -> None:
    history = JointHistory(truck.joints)
    history.add(states(truck, 2_000_000_000))
    history.add(states(truck, 1_000_000_000, 1))
    assert history.refused == 1
    other = replace(states(truck, 3_000_000_000, 2), names=[f"j{i}" for i in range(len(truck.joints))])
    history.add(other)
    assert history.refused == 2
    assert history.missing == truck.joints[0]
    history.add(states(truck, 1_500_000_000, 0, session="1" * 16))
    assert history.newest_ns == 1_500_000_000
    history.add(states(truck, 2_500_000_000, 1, session="1" * 16))
    assert history.at(2_000_000_000) is None, "a gap of a second is not bridged"


def test_scene_time_is_the_clock_modulo_the_period(truck: Scene) -> None:
    now = 1_800_000_000 * 10**9 + 7 * 10**9
    message = states(truck, now)
    assert message.positions == pytest.approx(truck.configuration(now * 1e-9 % 18.0), abs=1e-6)


def test_tum_folder_reads_back(tmp_path: Path) -> None:
    camera = WorkcellCamera(parse("shelf/a?size=160x120&rate=5&duration=0.4"))
    folder = tmp_path / "tum"
    assert write_tum(camera, folder) == 2
    frames = list(camera)
    rows = [line.split() for line in (folder / "depth.txt").read_text().splitlines() if line[0] != "#"]
    assert [stamp for stamp, _ in rows] == ["0.000000", "0.200000"]
    raw = cv2.imread(str(folder / rows[1][1]), cv2.IMREAD_UNCHANGED)
    assert raw.dtype == np.uint16
    assert np.abs(raw / 5000.0 - frames[1].depth).max() <= 1.01e-4
    assert np.array_equal(cv2.imread(str(folder / "rgb" / "0.200000.png")), frames[1].image)
    objects = cv2.imread(str(folder / "objects" / "0.200000.png"), cv2.IMREAD_UNCHANGED).astype(int) - 1
    assert np.array_equal(objects, frames[1].objects)
    with pytest.raises(SceneError, match="exists already"):
        write_tum(camera, folder)


def test_a_folder_of_a_carried_camera_tells_where_the_camera_was(tmp_path: Path) -> None:
    camera = WorkcellCamera(parse("eye-in-hand/hand?size=240x180&rate=10&duration=2"))
    folder = tmp_path / "tum"
    write_tum(camera, folder)
    true = read_trajectory(folder / "groundtruth.txt")
    assert TumFolder(folder).extrinsics is None, "the camera moves"
    options = SegmentOptions(tracker=TrackerConfig(max_features=150, moving=True))
    path = segment(str(folder), options).path
    assert path[-1][0] == 1_900_000_000
    begun = true.at(path[0][0])
    assert begun is not None
    for stamp_ns, pose in path:
        moved = true.at(stamp_ns)
        assert moved is not None
        moved = begun.inverse().after(moved)
        assert isinstance(pose.rotation, list)
        turn = Rotation.from_quat(pose.rotation).inv() * Rotation.from_matrix(moved.rotation)
        assert np.linalg.norm(moved.translation - pose.translation) < 0.01
        assert np.degrees(turn.magnitude()) < 1.0


def test_a_scene_that_breaks_the_conventions_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.xml"
    body = '<worldbody><body name="b"><joint name="j" type="slide"/><geom size="1"/></body></worldbody>'
    for custom, complaint in (
        ('<numeric name="motion:k" data="0 0 1 0"/>', "no such joint"),
        ('<numeric name="motion:j" data="0 0 1 0 2"/>', "growing times"),
        ('<numeric name="period" data="2"/><numeric name="motion:j" data="0 0 1 0"/>', "end at the period"),
    ):
        path.write_text(f"<mujoco>{body}<custom>{custom}</custom></mujoco>")
        with pytest.raises(SceneError, match=complaint):
            Scene(str(path))
    path.write_text("<mujoco><worldbody><nonsense/></worldbody></mujoco>")
    with pytest.raises(SceneError) as error:
        Scene(str(path))
    assert "\n" not in str(error.value)
