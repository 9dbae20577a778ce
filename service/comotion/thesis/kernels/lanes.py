"""Sixteen numbers at a time in compiled code: vector instructions whose order of sums is written down.

The compiler makes vector instructions of a sum along a row only where it may choose the order, and then
the last bits depend on what it sees around the sum. Here the order is that of the lanes: every process
gets the same bits, at the same speed. The functions can be called in compiled code alone.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types

WIDTH = 16
"""Lanes of a vector: one of AVX-512, two of AVX2, four of SSE or NEON."""

_VECTOR = ir.VectorType(ir.FloatType(), WIDTH)
_INDEX = ir.IntType(32)
_MAY_FUSE = ("contract",)


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__("float32 lanes")


_LANES = _Lanes()


@extending.register_model(_Lanes)
class _LanesModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)  # type: ignore[no-untyped-call]


def _instruction(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let compiled code call a function, without its first argument."""
    found: Callable[..., Any] = extending.intrinsic(function)
    return found


def _shuffle(builder: Any, lanes: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(lanes, lanes, ir.Constant(ir.VectorType(_INDEX, len(order)), order))


def _address(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [first]), _VECTOR.as_pointer())


@_instruction
def load(_: Any, array: Any, first: Any) -> Any:
    """``array[first : first + WIDTH]`` of a contiguous float32 array; nothing checks the bounds."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], *values), align=4)

    return _LANES(array, types.intp), generate


@_instruction
def store(_: Any, lanes: Any, array: Any, first: Any) -> Any:
    """``array[first : first + WIDTH] = lanes``; nothing checks the bounds."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = _address(context, builder, signature.args[1], *values[1:])
        builder.store(values[0], address, align=4)
        return context.get_dummy_value()

    return types.void(_LANES, array, types.intp), generate


@_instruction
def repeat(_: Any, number: Any) -> Any:
    """The same float32 in each lane."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        alone = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), values[0], _INDEX(0))
        return _shuffle(builder, alone, [0] * WIDTH)

    return _LANES(types.float32), generate


@_instruction
def add_product(_: Any, lanes: Any, one: Any, other: Any) -> Any:
    """``lanes + one * other``, rounded once where the processor can."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fadd(values[0], builder.fmul(*values[1:], flags=_MAY_FUSE), flags=_MAY_FUSE)

    return _LANES(_LANES, _LANES, _LANES), generate


@_instruction
def add(_: Any, one: Any, other: Any) -> Any:
    """``one + other``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fadd(*values)

    return _LANES(_LANES, _LANES), generate


@_instruction
def smaller(_: Any, one: Any, other: Any) -> Any:
    """The smaller number of each lane; that of `other` where one is not a number."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *values), *values)

    return _LANES(_LANES, _LANES), generate


@_instruction
def total(_: Any, lanes: Any) -> Any:
    """Sum over the lanes: halves are added until one number is left."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        rest, count = values[0], WIDTH
        while count > 1:
            count //= 2
            first, second = list(range(count)), list(range(count, 2 * count))
            rest = builder.fadd(_shuffle(builder, rest, first), _shuffle(builder, rest, second))
        return builder.extract_element(rest, _INDEX(0))

    return types.float32(_LANES), generate
