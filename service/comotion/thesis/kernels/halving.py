"""Compiled: products and sums for 2-means on the rows of a symmetric matrix, of which one triangle is stored.

Sums along a row are folded by quarters, element by element, which the compiler can turn into vector
instructions without being free to choose an order of its own: every process gets the same bits.
"""

import numpy as np
from numpy.typing import NDArray

from ...arrays import Bools, Floats, Slots
from ...compiled import compiled, numba_range

Matrix = NDArray[np.float32]

# Parts of the rows that threads work on, each with sums of its own; the same however many threads there are.
_CHUNKS = 8
# Up to this length a sum is not worth folding: it is less than four vectors of eight.
_UNFOLDED = 31
# 2-means of one-dimensional scores settles after so many steps, but for a few scores about the threshold.
_THRESHOLD_STEPS = 3


@compiled()
def _chunk_bounds(size: int, chunks: int) -> Slots:
    """Rows at which the chunks of a triangle begin: of equal area."""
    bounds = np.empty(chunks + 1, np.intp)
    for k in range(chunks + 1):
        bounds[k] = round(size * np.sqrt(k / chunks))
    return bounds


@compiled()
def _folded_sum(total: np.float32, values: Matrix, n: int) -> np.float32:
    """A number plus the sum of the first n values, which are overwritten."""
    while n > _UNFOLDED:
        quarter = (n + 3) // 4
        second, third = values[quarter : 2 * quarter], values[2 * quarter : 3 * quarter]
        fourth = values[3 * quarter : n]
        for c in range(len(fourth)):
            values[c] = (values[c] + second[c]) + (third[c] + fourth[c])
        for c in range(len(fourth), quarter):
            values[c] += second[c] + third[c]
        n = quarter
    for c in range(n):
        total += values[c]
    return total


@compiled(parallel=True)
def gather(
    matrix: Matrix,
    members: Slots,
    in_place: bool,
    room: Matrix,
    part: Bools,
    shared: bool,
) -> tuple[Floats, Floats, float]:
    """Copy rows and columns of a symmetric matrix into `room`, and sum them up on the way.

    Parameters
    ----------
    matrix
        float32 [P, P], read at and below the diagonal.
    members
        intp [n], ascending: which rows and columns.
    in_place
        The members are the first n rows: nothing is copied.
    room
        float32 [n, n] or larger, written at and below the diagonal.
    part
        bool [n]: members whose columns are summed for `part_sums` too.
    shared
        Whether all threads share the work.

    Returns
    -------
    sums, part_sums, least
        float64 [n] of each row over all columns and over those of `part`; the smallest element off the
        diagonal, 1 at most.
    """
    n, chunks = len(members), _CHUNKS if shared else 1
    bounds = _chunk_bounds(n, chunks)
    weight = part.astype(np.float32)
    # With signed indices the compiler would test each for counting from the end.
    columns = members.astype(np.uint32)
    sums, part_sums = np.zeros((chunks, n), np.float32), np.zeros((chunks, n), np.float32)
    # A minimum per column, element by element, for the same reason as folded sums.
    least = np.ones((chunks, n), np.float32)
    if shared:
        for k in numba_range(chunks):
            span = bounds[k], bounds[k + 1]
            _gather_rows(matrix, columns, in_place, room, weight, span, sums[k], part_sums[k], least[k])
    else:
        _gather_rows(matrix, columns, in_place, room, weight, (0, n), sums[0], part_sums[0], least[0])
    return _total(sums), _total(part_sums), least.min()


@compiled()
def _gather_rows(
    matrix: Matrix,
    members: NDArray[np.uint32],
    in_place: bool,
    room: Matrix,
    weight: Matrix,
    span: tuple[int, int],
    sums: Matrix,
    part_sums: Matrix,
    least: Matrix,
) -> None:
    terms, part_terms = np.empty(len(members), np.float32), np.empty(len(members), np.float32)
    for r in range(span[0], span[1]):
        source = matrix[members[r]]
        if not in_place:
            for c in range(r + 1):
                room[r, c] = source[members[c]]
        row = source[: r + 1] if in_place else room[r, : r + 1]
        x = weight[r]
        for c in range(r):
            a = row[c]
            terms[c], part_terms[c] = a, a * weight[c]
            sums[c] += a
            part_sums[c] += a * x
            least[c] = min(least[c], a)
        sums[r] += _folded_sum(row[r], terms, r)
        part_sums[r] += _folded_sum(row[r] * x, part_terms, r)


@compiled(parallel=True)
def multiply(matrix: Matrix, vector: Matrix, shared: bool) -> Floats:
    """Product of a symmetric matrix, float32 [n, n] or larger, and a vector, float32 [n]: float64 [n].

    The matrix is read at and below the diagonal; `shared`: whether all threads share the work.
    """
    n, chunks = len(vector), _CHUNKS if shared else 1
    bounds = _chunk_bounds(n, chunks)
    total = np.zeros((chunks, n), np.float32)
    if shared:
        for k in numba_range(chunks):
            _multiply_rows(matrix, vector, bounds[k], bounds[k + 1], total[k])
    else:
        _multiply_rows(matrix, vector, 0, n, total[0])
    return _total(total)


@compiled()
def _multiply_rows(matrix: Matrix, vector: Matrix, first: int, last: int, total: Matrix) -> None:
    terms = np.empty(len(vector), np.float32)
    for r in range(first, last):
        row, x = matrix[r, :r], vector[r]
        for c in range(r):
            a = row[c]
            terms[c] = a * vector[c]
            total[c] += a * x
        total[r] += _folded_sum(matrix[r, r] * x, terms, r)


@compiled()
def _total(parts: Matrix) -> Floats:
    total = np.zeros(parts.shape[1])
    for part in parts:
        for c in range(len(total)):
            total[c] += part[c]
    return total


@compiled()
def means(sums: Floats, half: Floats, count: int) -> tuple[Floats, float, float]:
    """Means of both halves, from the sums [n] of all rows and of the `count` rows of the second half.

    Returns
    -------
    across, threshold, scatter
        float64 [n], the second mean less the first; the product with it above which a row is nearer to the
        second mean; and (3.6) less the sum of all squared rows, which is the same for every split.
    """
    n, across = len(sums), np.empty(len(sums))
    first, second = 0.0, 0.0
    for i in range(n):
        mean, other = (sums[i] - half[i]) / (n - count), half[i] / count
        first += mean * mean
        second += other * other
        across[i] = other - mean
    return across, (second - first) / 2, -(n - count) * first - count * second


@compiled()
def nearer(score: Floats, threshold: float, second: Bools) -> tuple[Bools, int, int]:
    """Rows nearer to the second mean, bool [n]; how many they are, and how many have changed sides."""
    found, count, moved = np.empty(len(score), np.bool_), 0, 0
    for i in range(len(score)):
        found[i] = score[i] > threshold
        count += found[i]
        moved += found[i] != second[i]
    return found, count, moved


@compiled()
def cut(score: Floats) -> Bools:
    """Two halves of numbers [n] by 2-means; all but the least where that leaves one half empty."""
    n = len(score)
    all_but_least: Bools = score > score.min()
    threshold, second = score.mean(), all_but_least
    for _ in range(_THRESHOLD_STEPS):
        sums, count = np.zeros(2), 0
        for x in score:
            sums[int(x > threshold)] += x
            count += x > threshold
        if not 0 < count < n:
            return all_but_least
        second = score > threshold
        threshold = (sums[1] / count + sums[0] / (n - count)) / 2
    return second
