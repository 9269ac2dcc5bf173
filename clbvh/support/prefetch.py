"""The processor's prefetch instruction, for compiled loops."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

_INT = ir.IntType(32)
_BYTES = ir.IntType(8).as_pointer()

# Arguments of LLVM's prefetch: reading, high locality, data.
_TO_READ_INTO_ALL_CACHES = (0, 3, 1)


@intrinsic
def prefetch(typing_context, array, index):
    """Ask for element `index` of a C-contiguous array before it is needed; any index is allowed."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        pointer = builder.bitcast(builder.gep(data, [index]), _BYTES)
        types_of_call = ir.FunctionType(ir.VoidType(), [_BYTES, _INT, _INT, _INT])
        ask = builder.module.declare_intrinsic("llvm.prefetch", [_BYTES], types_of_call)
        builder.call(ask, [pointer, *(ir.Constant(_INT, value) for value in _TO_READ_INTO_ALL_CACHES)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate
