"""Parameters of the default method in spaces of unit px.

They were chosen together on public sequences; docs/research/pixels.md says how.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Count = Annotated[int, Field(ge=1, le=100_000)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
# Below 1, so that a kernel cannot veto a pair alone; above 0, so that no product vanishes.
Floor = Annotated[float, Field(gt=0, lt=1)]


class PixelsConfig(BaseModel):
    """Parameters of grouping in pixel space."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    key_frames: Annotated[int, Field(ge=2, le=1000)] = Field(
        default=24, description="instants of the window that trajectories are compared at"
    )
    least_seen: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=4, description="key frames that a trajectory must be seen in to be compared"
    )
    most_tracks: Count = Field(
        default=1200, description="most trajectories that are compared; the others follow their neighbours"
    )
    ended_share: Weight = Field(
        default=0.5, description="most ended trajectories that are compared, as a share of the current ones"
    )
    few_tracks: Count = Field(
        default=400, description="number of compared trajectories up to which `ended_share` sets no limit"
    )
    steps: Annotated[tuple[Count, ...], Field(min_length=1)] = Field(
        default=(1, 4, 12), description="key frames; lengths of the frame pairs in which motion is measured"
    )
    local_motions: Count = Field(default=600, description="number of local affine motions")
    members: Annotated[int, Field(ge=3, le=1000)] = Field(
        default=8, description="trajectories that each local motion is fitted to"
    )
    reaches: Annotated[tuple[Count, ...], Field(min_length=1)] = Field(
        default=(16, 32),
        description="numbers of nearest trajectories from which the members are drawn; each serves "
        "an even share of the local motions",
    )
    motion_weight: Weight = Field(
        default=10.0, description="weight of a difference in displacement against a distance in the image"
    )
    ridge: Positive = Field(default=25.0, description="px²; regularisation of a local motion, per member")
    cap: Positive = Field(default=400.0, description="px²; squared residual from which on it costs no more")
    noise_factor: Positive = Field(
        default=32.0, description="width of the preference kernel, as a multiple of the typical best residual"
    )
    noise_floor: Positive = Field(
        default=0.05, description="px²; added to the width of the preference kernel"
    )
    coverage_power: Annotated[int, Field(ge=0, le=20)] = Field(
        default=3,
        description="power of the share of motion that a trajectory was seen in, in the evidence of a pair",
    )
    completion_rank: Annotated[int, Field(ge=1, le=100)] = Field(
        default=6, description="rank of the completion of unseen positions"
    )
    completion_rounds: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=40, description="iterations of the completion of unseen positions"
    )
    ranks: Annotated[tuple[Annotated[int, Field(ge=1, le=100)], ...], Field(min_length=1)] = Field(
        default=(5, 6, 8, 10),
        description="numbers of singular vectors over which the shape interaction is averaged",
    )
    preference_floor: Floor = Field(default=0.001, description="added to the preference kernel of a pair")
    interaction_floor: Floor = Field(
        default=0.01, description="added to the mean shape interaction of a pair"
    )
    rank_floor: Floor = Field(
        default=0.001, description="added to the shape interaction of a pair at each rank"
    )
    evidence_floor: Floor = Field(
        default=0.0005, description="evidence of a pair that no local motion covers"
    )
    supercluster_similarity: Share = Field(
        default=0.08, description="mean similarity down to which trajectories are linked into superclusters"
    )
    merge_similarity: Floor = Field(
        default=0.0075,
        description="mean similarity at which superclusters merge if the smaller has `merge_size` members",
    )
    merge_size: Count = Field(
        default=40,
        description="members; the threshold grows with the root of the smaller one's size over this",
    )
    merge_cap: Count = Field(default=100, description="members from which on the threshold grows no more")
    merge_range: tuple[Positive, Positive] = Field(
        default=(0.15, 20.0),
        description="multiples of the threshold below which no superclusters merge, and from which on all do",
    )
    boundary_distance: Weight = Field(
        default=0.86,
        description="weight of log(1 + distance in px) of two groups in the evidence that they are one",
    )
    boundary_least: Finite = Field(
        default=0.55, description="nat; taken from the evidence that two groups are one"
    )
    ratio_weight: Weight = Field(
        default=0.3,
        description="weight of the log multiple of the threshold in the evidence that two groups are one",
    )
    epipolar_weight: Weight = Field(
        default=1.08,
        description="evidence needed per log ratio of two groups' joint epipolar residual to their own",
    )
    epipolar_limits: tuple[Finite, Finite] = Field(
        default=(-0.2, 2.5), description="nat; limits of that log ratio"
    )
    epipolar_unknown: Finite = Field(
        default=0.3, description="nat; that log ratio where the epipolar geometry cannot be estimated"
    )
    drift: Weight = Field(
        default=0.02,
        description="share of a motion in the image by which features drift or a lens distorts it",
    )
    epipolar_contradiction: Finite = Field(
        default=0.8,
        description="nat; log ratio of two groups' joint epipolar residual over wide baselines to noise and "
        "drift, above which they are two bodies",
    )
    parallax_excess: Finite = Field(
        default=1.2,
        description="nat; largest log ratio of two groups' joint affine residual to the larger own one at "
        "which parallax within them explains that between them",
    )
    parallax_epipolar: Finite = Field(
        default=0.2,
        description="nat; largest log ratio of two groups' joint epipolar residual over wide baselines to "
        "their own at which they are parts of one body with parallax",
    )
    smallest: Count = Field(default=5, description="members below which a group dissolves")
    smallest_share: Share = Field(
        default=0.02, description="share of the compared trajectories below which a group dissolves"
    )
    held_together: Weight = Field(
        default=0.5, description="nat; added to the evidence of two groups that were one hypothesis before"
    )
    held_apart: Weight = Field(
        default=0.25, description="nat; taken from the evidence of two groups that were two hypotheses before"
    )
