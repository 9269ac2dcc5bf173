"""Compiled functions as parts of others: the versions that only machine code calls.

numba makes each function that it meets in a call complete: with a wrapper for Python, machine code of its own, and a
file of its own. The caller needs none of that, since it links the function's LLVM code into its own. Without, the first
hit on a new machine takes two thirds of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from numba import types
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering


class Calls:
    """What compiled functions that call a function are told about it.

    Versions that Python has called serve them, too.

    Parameters
    ----------
    function : dispatcher
        Python calls it.
    make_part : function
        Returns another dispatcher of the same function, with `PartCompiler`.
    """

    def __init__(self, function: Any, make_part: Callable[[], Any]) -> None:
        self._function, self._make_part = function, make_part
        self._find_complete = function.get_call_template

    @cached_property
    def part(self) -> Any:
        """The dispatcher of the versions that only machine code calls. Few processes compile, and need it."""
        return self._make_part()

    def get_call_template(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """Return numba's template of a call, for lists of types.

        All calls share one version for each list. numba would compile another version for each literal number, as in
        ``f(x, 3)``; LLVM still knows the number where it inlines the function.
        """
        arguments = tuple(types.unliteral(argument) for argument in arguments)
        named = {name: types.unliteral(argument) for name, argument in named.items()}
        _, folded = self._function.fold_argument_types(arguments, named)
        is_complete = tuple(folded) in self._function.overloads
        return (self._find_complete if is_complete else self.part.get_call_template)(arguments, named)

    def get_overload(self, arguments: tuple[Any, ...]) -> Any:
        """Return what numba knows the version for a list of types by."""
        return (self._function.overloads.get(arguments) or self.part.overloads[arguments]).entry_point


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Turns a typed function into LLVM code, and no further."""

    _name = "clbvh_part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.flags.no_compile = True
        super().run_pass(state)
        library = state.library
        entry_point: Any = [].append  # numba takes a built-in function, and this one is like no other

        def finalize() -> None:
            library._finalized = True

        library._finalize_final_module = finalize  # numba would add the module to the process, and compile it
        state.targetctx.insert_user_function(entry_point, state.cr.fndesc, [library])
        state.cr = state.cr._replace(cfunc=entry_point)
        return True


class PartCompiler(CompilerBase):
    """The compiler of functions that only machine code calls."""

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, with a lowering of our own."""
        pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
        pipeline.passes = [
            (_PartLowering if each is NativeLowering else each, description) for each, description in pipeline.passes
        ]
        pipeline.finalize()
        return [pipeline]
