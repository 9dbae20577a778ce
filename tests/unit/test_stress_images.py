"""The image simulator, and its families in the stress experiment."""

import numpy as np
import pytest

from comotion_experiments.stress import FAMILIES, run_family

IMAGES = [name for name, family in FAMILIES.items() if family.of_images]


@pytest.mark.parametrize("name", IMAGES[::4])
def test_a_family_gives_the_same_sequences_twice(name: str) -> None:
    one, again = (FAMILIES[name].scenes(2, scenes=1)[0] for _ in range(2))
    other = FAMILIES[name].scenes(0, scenes=1)[0]
    assert np.array_equal(one.positions, again.positions, equal_nan=True)
    assert not np.array_equal(one.truth, other.truth)
    assert one.positions.shape[1] == len(one.truth) >= 20
    assert (np.isfinite(one.positions[..., 0]).sum(axis=0) >= 5).all()
    bodies = FAMILIES[name].parameters.get("bodies", (2, 2))
    assert 1 <= one.objects() <= bodies[1] + 1


def test_a_still_scene_is_one_object() -> None:
    found = run_family("image_still", 0, scenes=1)
    assert (found["error"], found["found"], found["true"], found["exact"]) == (0.0, 1.0, 1.0, 1.0)
