"""Parameters of the fusion: nested by method, checked, and read again as they were dumped."""

import pytest
from pydantic import ValidationError

from comotion import FusionConfig
from comotion.config import Camera, LinkingConfig, PixelsConfig, ThesisConfig

CAMERA = Camera(fx=1, fy=1, cx=0, cy=0, translation=(0, 0, 0), quaternion=(0, 0, 0, 1))


@pytest.mark.parametrize(
    "wrong",
    [
        {"rigid": {"pose_price": 0}},
        {"motion": {"pose_price": 1}},
        {"thesis": {"looseness": 1}},
        {"v_move": 1},
        {"pixels": {"most_tracks": 0}},
        {"pixels": {"key_frames": 1}},
        {"looseness": 1},
    ],
)
def test_parameters_are_checked(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        FusionConfig(**wrong)


def test_what_is_dumped_can_be_read() -> None:
    config = FusionConfig(
        thesis=ThesisConfig(sigma_switch=0.01),
        pixels=PixelsConfig(key_frames=12),
        linking=LinkingConfig(cameras={"a/pixels": CAMERA}),
    )
    assert FusionConfig.model_validate_json(config.model_dump_json()) == config
    assert FusionConfig(**config.model_dump()) == config
