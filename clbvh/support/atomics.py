"""The processor's atomic addition, for compiled loops of several threads or processes on one array."""

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.extending import intrinsic


@intrinsic
def add_atomically(typing_context, counter, amount):
    """Add to word 0 of an int64 array, undivided by any other thread or process; return what was there."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", word, arguments[1], "seq_cst")

    return types.int64(counter, types.int64), generate
