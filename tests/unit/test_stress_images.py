"""The image simulator, and its families in the stress experiment."""

import numpy as np
import pytest

from comotion_experiments.stress import IMAGE_FAMILIES, run_image_family


@pytest.mark.parametrize("name", list(IMAGE_FAMILIES)[::4])
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
