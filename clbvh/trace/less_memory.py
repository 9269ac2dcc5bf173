"""A query whose batch does not fit the device is asked again in smaller pieces.

Whether a batch fits is known only when the driver refuses it: other programs use the same memory.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from ..errors import DeviceMemoryError
from .launch import Caster

_Rest = ParamSpec("_Rest")
_Result = TypeVar("_Result")


def cut_smaller_when_full(
    query: Callable[Concatenate[Caster, _Rest], _Result],
) -> Callable[Concatenate[Caster, _Rest], _Result]:
    """Decorate a query that takes a `Caster` first and can begin again: it does so while its pieces can be halved.

    The pieces stay small for later queries of the caster. The user's progress begins again, too.
    """

    @functools.wraps(query)
    def ask(caster: Caster, /, *arguments: _Rest.args, **named: _Rest.kwargs) -> _Result:
        while True:
            tried = caster.halvings
            try:
                return query(caster, *arguments, **named)
            except DeviceMemoryError:
                if not caster.cut_smaller(tried):
                    raise

    return ask
