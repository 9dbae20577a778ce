"""The image simulator, and its families in the stress experiment."""

import numpy as np
import pytest

from comotion_experiments.stress import IMAGE_FAMILIES, run_image_family
from comotion_experiments.stress.solids import Glide, ImageScene, Pinhole, Solid, observe_images

ZERO = np.zeros(3)


def glide(place=ZERO, velocity=ZERO, turn=ZERO, facing=ZERO) -> Glide:
    return Glide(
        place=np.array(place, float), velocity=np.array(velocity, float), facing=facing, turn=turn, swing=ZERO
    )


def wall(z: float = 4.0, features: int = 50) -> Solid:
    return Solid(glide((0, 0, z)), np.array([2.0, 2.0, 0.0]), features, 1)


def scene(*solids: Solid, **options) -> ImageScene:
    camera = options.pop("camera", glide())
    return ImageScene(solids=list(solids), camera=Pinhole(motion=camera), sigma=0.0, **options)


def test_a_wall_before_a_resting_camera_rests() -> None:
    tracks = observe_images(scene(wall()), 0)
    assert tracks.positions.shape == (30, 50, 2)
    assert np.allclose(tracks.positions, tracks.positions[0])
    reach = 525.0 / 4.0  # px; the wall reaches 1 m to each side at 4 m
    assert np.abs(tracks.positions[0] - [320, 240]).max() <= reach + 1e-9


def test_what_is_nearer_moves_further_as_the_camera_moves() -> None:
    camera = glide(velocity=(0.1, 0.0, 0.0))
    tracks = observe_images(
        scene(wall(2.0, 20), Solid(wall(8.0).motion, wall().size, 20, 2), camera=camera), 0
    )
    moved = tracks.positions[-1] - tracks.positions[0]
    seconds = tracks.times[-1]
    assert np.allclose(moved[tracks.objects == 1], [-525 * 0.1 * seconds / 2.0, 0.0])
    assert np.allclose(moved[tracks.objects == 2], [-525 * 0.1 * seconds / 8.0, 0.0])


def test_only_faces_that_turn_to_the_camera_are_seen() -> None:
    box = Solid(glide((0, 0, 2)), np.array([0.4, 0.4, 0.4]), 200, 1)
    positions = observe_images(scene(box), 0).positions[0]
    # From straight ahead only the front face is seen, 1.8 m away.
    assert np.abs(positions - [320, 240]).max() <= 525 * 0.2 / 1.8 + 1e-9


def test_a_box_hides_what_is_behind_it() -> None:
    box = Solid(glide((0, 0, 2)), np.array([0.4, 0.4, 0.1]), 0, 2)
    positions = observe_images(scene(wall(4.0, 200), box), 0).positions[0]
    assert (np.abs(positions - [320, 240]).max(axis=1) > 525 * 0.2 / 1.95 - 1e-9).all()


def passing() -> tuple[Solid, Solid]:
    """A box that passes before a wall."""
    return wall(4.0, 200), Solid(glide((-0.8, 0, 2), (0.8, 0, 0)), np.array([0.4, 0.4, 0.1]), 0, 2)


def test_features_that_were_hidden_end_or_come_back() -> None:
    ended = observe_images(scene(*passing(), complete=False), 0).positions
    back = observe_images(scene(*passing(), complete=False, returns=True), 0).positions

    def breaks(positions: np.ndarray) -> int:
        """Count gaps within trajectories."""
        seen = np.isfinite(positions[..., 0])
        begun, goes_on = np.maximum.accumulate(seen), np.maximum.accumulate(seen[::-1])[::-1]
        return int((begun & goes_on & ~seen).any(axis=0).sum())

    assert breaks(ended) == 0
    assert breaks(back) > 0
    assert np.isfinite(observe_images(scene(*passing()), 0).positions).all()


def test_dropouts_shorten_lives() -> None:
    tracks = observe_images(scene(wall(), complete=False, dropout=1.0, shortest=5), 0)
    seen = np.isfinite(tracks.positions[..., 0]).sum(axis=0)
    assert seen.min() >= 5
    assert seen.max() < 30


@pytest.mark.parametrize("name", IMAGE_FAMILIES)
def test_a_family_gives_the_same_sequences_twice(name: str) -> None:
    one, again = (IMAGE_FAMILIES[name].sequences(2, scenes=1)[0] for _ in range(2))
    other = IMAGE_FAMILIES[name].sequences(0, scenes=1)[0]
    assert np.array_equal(one.positions, again.positions, equal_nan=True)
    assert not np.array_equal(one.truth, other.truth)
    assert one.positions.shape[1] == len(one.truth) >= 20
    assert (np.isfinite(one.positions[..., 0]).sum(axis=0) >= 5).all()
    bodies = IMAGE_FAMILIES[name].parameters.get("bodies", (2, 2))
    assert 1 <= one.objects() <= bodies[1] + 1


def test_a_still_scene_is_one_object() -> None:
    found = run_image_family("image_still", 0, scenes=1)
    assert found.errors == [0.0]
    assert (found.figures.found, found.figures.true, found.figures.exact) == (1.0, 1.0, 1.0)
