"""Vectors of numbers that are adjacent in memory, loaded into one vector register.

Where a kernel adds to one array and reads from another, the compiler must assume that both share memory: it neither
keeps a sum of lanes in a register nor vectorises the loop over them. These functions make the vectors explicit.
"""

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, register_model

_FAST = ("contract", "nsz", "reassoc")


class Lanes(types.Type):
    """A vector of float32."""

    def __init__(self, width):
        self.width = width
        super().__init__(name=f"Lanes({width})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(ir.FloatType(), fe_type.width))


@intrinsic(prefer_literal=True)
def load(typing_context, array, at, width):  # noqa: ARG001 - Numba's signature
    """Load the lanes of a flat float32 array from an index on; the width is a literal."""
    lanes = Lanes(width.literal_value)

    def code(context, builder, signature, arguments):
        return builder.load(_place(context, builder, signature.args[0], arguments, lanes.width), align=4)

    return lanes(array, types.uint64, width), code


@intrinsic
def store(typing_context, array, at, lanes):  # noqa: ARG001 - Numba's signature
    """Store lanes into a flat float32 array from an index on."""

    def code(context, builder, signature, arguments):
        builder.store(arguments[2], _place(context, builder, signature.args[0], arguments, lanes.width), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, lanes), code


@intrinsic
def scaled(typing_context, factor, lanes):  # noqa: ARG001 - Numba's signature
    """Multiply each lane by the factor."""

    def code(context, builder, signature, arguments):  # noqa: ARG001
        vector = ir.VectorType(ir.FloatType(), lanes.width)
        order = ir.Constant(ir.VectorType(ir.IntType(32), lanes.width), [0] * lanes.width)
        nothing = ir.Constant(vector, ir.Undefined)
        first = builder.insert_element(nothing, arguments[0], ir.Constant(ir.IntType(32), 0))
        return builder.fmul(builder.shuffle_vector(first, nothing, order), arguments[1], flags=_FAST)

    return lanes(types.float32, lanes), code


@intrinsic
def plus(typing_context, one, other):  # noqa: ARG001 - Numba's signature
    """Add lane by lane."""

    def code(context, builder, signature, arguments):  # noqa: ARG001
        return builder.fadd(*arguments, flags=_FAST)

    return one(one, one), code


def _place(context, builder, array_type, arguments, width):
    data = context.make_array(array_type)(context, builder, arguments[0]).data
    lanes = ir.VectorType(ir.FloatType(), width).as_pointer()
    return builder.bitcast(builder.gep(data, [arguments[1]], inbounds=True), lanes)
