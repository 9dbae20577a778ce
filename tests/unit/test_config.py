"""Parameters of the fusion: nested by method, with the flat names of before."""

import pytest
from pydantic import ValidationError

from comotion import FusionConfig
from comotion.config import Camera, LinkingConfig, PixelsConfig, RigidConfig, ThesisConfig

CAMERA = Camera(fx=1, fy=1, cx=0, cy=0, translation=(0, 0, 0), quaternion=(0, 0, 0, 1))


def test_flat_names_are_accepted_and_can_be_read() -> None:
    flat = FusionConfig(
        sigma_switch=0.01,
        v_move=None,
        stop_affinity=0.3,
        clustering="eigengap",
        motion={"looseness": 0.4},
        cameras={"a/pixels": CAMERA},
    )
    assert flat == FusionConfig(
        thesis=ThesisConfig(sigma_switch=0.01, v_move=None, stop_affinity=0.3, clustering="eigengap"),
        rigid=RigidConfig(looseness=0.4),
        linking=LinkingConfig(cameras={"a/pixels": CAMERA}),
    )
    assert (flat.sigma_switch, flat.v_move, flat.stop_affinity) == (0.01, None, 0.3)
    assert (flat.clustering, flat.motion.looseness) == ("eigengap", 0.4)
    assert flat.cameras == {"a/pixels": CAMERA}
    with pytest.raises((ValidationError, AttributeError)):
        flat.sigma_switch = 0.02


def test_a_flat_name_joins_the_other_parameters_of_its_group() -> None:
    for thesis in ({"v_move": None}, ThesisConfig(v_move=None)):
        config = FusionConfig(sigma_switch=0.01, thesis=thesis)
        assert config.thesis == ThesisConfig(sigma_switch=0.01, v_move=None)


def test_a_copy_changes_parameters_by_either_name() -> None:
    config = FusionConfig(sigma_switch=0.01, window=5)
    copy = config.model_copy(update={"v_move": None, "motion": RigidConfig(stay=3), "period": 0.2})
    assert copy == FusionConfig(
        thesis=ThesisConfig(sigma_switch=0.01, v_move=None),
        rigid=RigidConfig(stay=3),
        window=5,
        period=0.2,
    )
    assert config.thesis.v_move == "auto"
    assert config.model_copy() == config


def test_a_parameter_given_twice_is_an_error() -> None:
    for twice in (
        {"sigma_switch": 0.01, "thesis": {"sigma_switch": 0.01}},
        {"sigma_switch": 0.01, "thesis": ThesisConfig(sigma_switch=0.02)},
    ):
        with pytest.raises(ValidationError, match=r"sigma_switch and thesis\.sigma_switch are the same"):
            FusionConfig(**twice)
    with pytest.raises(ValidationError, match="motion and rigid are the same group"):
        FusionConfig(motion={}, rigid={})


@pytest.mark.parametrize(
    "wrong",
    [
        {"rigid": {"pose_price": 0}},
        {"motion": {"pose_price": 0}},
        {"thesis": {"looseness": 1}},
        {"thesis": 3, "v_move": 1},
        {"pixels": {"steps": []}},
        {"pixels": {"merge_range": (0.1,)}},
        {"looseness": 1},
    ],
)
def test_parameters_are_checked(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        FusionConfig(**wrong)


def test_what_is_dumped_can_be_read() -> None:
    config = FusionConfig(sigma_switch=0.01, pixels=PixelsConfig(steps=(1, 2)), cameras={"a/pixels": CAMERA})
    assert FusionConfig.model_validate_json(config.model_dump_json()) == config
    assert FusionConfig(**config.model_dump()) == config
