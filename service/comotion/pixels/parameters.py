"""The one parameter set of the method; chosen on development recordings, see docs/pixels.md."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PixelParameters:
    """Parameters of grouping in pixel space.

    Attributes
    ----------
    key_frames, least_seen
        Instants of the window that are looked at, and on how many of them a trajectory must be seen.
    most_tracks, dead_share, few_tracks
        Trajectories that are compared with one another: up to the first number; beyond the last one
        no more dead ones than this share of the living. Further ones follow their neighbours.
    steps
        Lengths of the frame pairs, in key frames.
    local_motions, members, reaches
        Number of local motions, trajectories that each is fitted to, and the numbers of nearest
        trajectories these are drawn from (the motions are shared out evenly among the reaches).
    motion_weight
        Weight of differing displacement against distance in the image, for "nearest".
    ridge, cap
        px²; regularisation per member of a local motion, and where a squared residual saturates.
    noise_factor, noise_floor
        Width of the preference kernel over the typical best residual, and px² added to it.
    coverage_power
        How fast evidence falls with the share of motion that a trajectory was not seen in.
    completion_rank, completion_rounds
        Low-rank completion of unseen positions.
    ranks
        Numbers of singular vectors over which shape interaction is averaged.
    preference_floor, interaction_floor, rank_floor
        Keep one kernel, or one rank, from vetoing a pair alone.
    evidence_floor
        Evidence of a pair that no local motion covers.
    piece_similarity
        Trajectories are linked into pieces down to this mean similarity.
    merge_similarity, merge_size, merge_cap
        Pieces merge at this mean similarity if the smaller has `merge_size` members, at one that
        grows with the root of that number, up to `merge_cap` members.
    merge_range
        Below the first multiple of that threshold no two pieces merge, from the second one on all do.
    border_distance, border_least, ratio_weight
        Between them, log drop of similarity across the border + `border_distance` · log(1 + distance
        in px) + `ratio_weight` · log of the multiple must reach `border_least`, plus
    epipolar_weight, epipolar_limits, epipolar_unknown
        what the epipolar geometry asks for: `epipolar_weight` times the log ratio of joint to own
        residual (limited; `epipolar_unknown` if it cannot be told).
    smallest, smallest_share
        Smaller groups dissolve, by number and by share of all.
    held_together, held_apart
        Added for groups of one hypothesis before, subtracted for groups of different ones.
    """

    key_frames: int = 24
    least_seen: int = 4
    most_tracks: int = 1200
    dead_share: float = 0.5
    few_tracks: int = 400
    steps: tuple[int, ...] = (1, 4, 12)
    local_motions: int = 600
    members: int = 8
    reaches: tuple[int, ...] = (16, 32)
    motion_weight: float = 10.0
    ridge: float = 25.0
    cap: float = 400.0
    noise_factor: float = 32.0
    noise_floor: float = 0.05
    coverage_power: int = 3
    completion_rank: int = 6
    completion_rounds: int = 40
    ranks: tuple[int, ...] = (5, 6, 8, 10)
    preference_floor: float = 0.001
    interaction_floor: float = 0.01
    rank_floor: float = 0.001
    evidence_floor: float = 0.0005
    piece_similarity: float = 0.08
    merge_similarity: float = 0.0075
    merge_size: int = 40
    merge_cap: int = 100
    merge_range: tuple[float, float] = (0.15, 6.0)
    border_distance: float = 0.86
    border_least: float = 0.55
    ratio_weight: float = 0.3
    epipolar_weight: float = 1.08
    epipolar_limits: tuple[float, float] = (-0.2, 2.5)
    epipolar_unknown: float = 0.3
    smallest: int = 5
    smallest_share: float = 0.02
    held_together: float = 0.5
    held_apart: float = 0.25
