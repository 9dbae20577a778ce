"""Compiled: products and sums for 2-means on the rows of a symmetric matrix, stored as one triangle."""

import numpy as np
from numpy.typing import NDArray

from ...arrays import Bools, Floats, Slots
from ...compiled import compiled, numba_range
from .lanes import WIDTH, add, add_product, load, repeat, smaller, store, total

Matrix = NDArray[np.float32]

# Parts of the rows that threads work on, each with sums of its own; the same however many threads there are.
_CHUNKS = 8
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
    least = np.ones(chunks, np.float32)
    if shared:
        _gather_chunks(matrix, columns, in_place, room, weight, bounds, sums, part_sums, least)
    else:
        least[0] = _gather_rows(matrix, columns, in_place, room, weight, (0, n), sums[0], part_sums[0])
    return _total(sums), _total(part_sums), least.min()


# The loops over chunks are functions of their own: in larger ones Numba wakes the other threads even where
# it does not come to the loop, which takes milliseconds on a loaded machine.
@compiled(parallel=True)
def _gather_chunks(
    matrix: Matrix,
    members: NDArray[np.uint32],
    in_place: bool,
    room: Matrix,
    weight: Matrix,
    bounds: Slots,
    sums: Matrix,
    part_sums: Matrix,
    least: Matrix,
) -> None:
    for k in numba_range(len(least)):
        span = bounds[k], bounds[k + 1]
        least[k] = _gather_rows(matrix, members, in_place, room, weight, span, sums[k], part_sums[k])


@compiled(fastmath={"contract"})
def _gather_rows(
    matrix: Matrix,
    members: NDArray[np.uint32],
    in_place: bool,
    room: Matrix,
    weight: Matrix,
    span: tuple[int, int],
    sums: Matrix,
    part_sums: Matrix,
) -> float:
    """Copy some rows, add them to the sums, and find the smallest element off the diagonal; 1 at most."""
    least, lowest = repeat(np.float32(1)), np.float32(1)
    for r in range(span[0], span[1]):
        source = matrix[members[r]]
        if not in_place:
            for c in range(r + 1):
                room[r, c] = source[members[c]]
        row, x = source if in_place else room[r], weight[r]
        found, part, xs, stop = repeat(np.float32(0)), repeat(np.float32(0)), repeat(x), r - r % WIDTH
        for c in range(0, stop, WIDTH):
            a = load(row, c)
            least, found, part = smaller(a, least), add(found, a), add_product(part, a, load(weight, c))
            store(add(load(sums, c), a), sums, c)
            store(add_product(load(part_sums, c), a, xs), part_sums, c)
        rest, part_rest = row[r], row[r] * x
        for c in range(stop, r):
            a = row[c]
            lowest = min(lowest, a)
            rest, part_rest = rest + a, part_rest + a * weight[c]
            sums[c], part_sums[c] = sums[c] + a, part_sums[c] + a * x
        sums[r] += total(found) + rest
        part_sums[r] += total(part) + part_rest
    lows = np.empty(WIDTH, np.float32)
    store(least, lows, 0)
    return float(min(lowest, lows.min()))


@compiled()
def multiply(matrix: Matrix, vector: Matrix, shared: bool) -> Floats:
    """Product of a symmetric matrix, float32 [n, n] or larger, and a vector, float32 [n]: float64 [n].

    The matrix is read at and below the diagonal; `shared`: whether all threads share the work.
    """
    n, chunks = len(vector), _CHUNKS if shared else 1
    bounds = _chunk_bounds(n, chunks)
    products = np.zeros((chunks, n), np.float32)
    if shared:
        _multiply_chunks(matrix, vector, bounds, products)
    else:
        _multiply_rows(matrix, vector, 0, n, products[0])
    return _total(products)


@compiled(parallel=True)
def _multiply_chunks(matrix: Matrix, vector: Matrix, bounds: Slots, products: Matrix) -> None:
    for k in numba_range(len(products)):
        _multiply_rows(matrix, vector, bounds[k], bounds[k + 1], products[k])


@compiled(fastmath={"contract"})
def _multiply_rows(matrix: Matrix, vector: Matrix, first: int, last: int, product: Matrix) -> None:
    for r in range(first, last):
        row, x = matrix[r], vector[r]
        found, xs, stop = repeat(np.float32(0)), repeat(x), r - r % WIDTH
        for c in range(0, stop, WIDTH):
            a = load(row, c)
            found = add_product(found, a, load(vector, c))
            store(add_product(load(product, c), a, xs), product, c)
        rest = row[r] * x
        for c in range(stop, r):
            rest += row[c] * vector[c]
            product[c] += row[c] * x
        product[r] += total(found) + rest


@compiled()
def _total(parts: Matrix) -> Floats:
    sums = np.zeros(parts.shape[1])
    for part in parts:
        for c in range(len(sums)):
            sums[c] += part[c]
    return sums


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
