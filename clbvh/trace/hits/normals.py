"""The normals of hits: an array that can be called for other normals of the same hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Normals(np.ndarray):
    """(..., 3) float64: the normals of hits, and a function that returns others; see `Hits.normals`.

    Behaves as a plain array and shows itself as one. Arithmetic, functions of numpy, indices and pickles give plain
    arrays, which cannot be called.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> with clbvh.Tracer(ball) as tracer:
    ...     hits = tracer.closest_hit([[0.1, 0.2, 0], [0.1, 0.2, 5]], [[0, 0, 1], [0, 0, -1]])
    >>> hits.normals.round(2)
    array([[0.09, 0.15, 0.98],
           [0.09, 0.15, 0.98]])
    >>> hits.normals(facing=True).round(2)
    array([[-0.09, -0.15, -0.98],
           [ 0.09,  0.15,  0.98]])
    >>> type(2 * hits.normals), type(hits.normals[0])
    (<class 'numpy.ndarray'>, <class 'numpy.ndarray'>)
    """

    _find: Callable[[NDArray[np.float64], bool, bool], NDArray[np.float64]] | None = None

    @classmethod
    def _of(
        cls, normals: NDArray[np.float64], find: Callable[[NDArray[np.float64], bool, bool], NDArray[np.float64]]
    ) -> Normals:
        """Return an array that calls a function with itself and with the answers to `smooth` and `facing`."""
        callable_normals = normals.view(cls)
        callable_normals._find = find
        return callable_normals

    def __call__(self, *, smooth: bool = False, facing: bool = False) -> NDArray[np.float64]:
        """Return (..., 3) float64: other normals of the same hits, of length 1; NaN on a miss.

        Parameters
        ----------
        smooth : bool, optional
            Normals that change continuously over the faces: those of `Mesh.vertex_normals`, interpolated with u and v,
            and in a scene transformed as normals are. Each is on the side to which the face's own normal points; where
            it would not be, at creases sharper than a right angle or where faces around disagree about their sides, it
            is the face's own. A sphere has the same normals anyway.
        facing : bool, optional
            On the side from which the ray came: turned by `Hits.is_front`. So the product of the ray's direction with a
            normal of `smooth=False` is never above zero. A smooth one keeps to the side of the face, and near a
            silhouette it may still point away from the ray.

        Raises
        ------
        ConfigError
            `facing` for hits that do not know from which side the rays came.
        """
        if self._find is None:
            raise TypeError("only the normals of hits can be called: hits.normals(smooth=..., facing=...)")
        return self._find(np.asarray(self), smooth, facing)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **arguments: Any) -> Any:
        if "out" in arguments:
            arguments["out"] = tuple(_plain(out) for out in arguments["out"])
        return getattr(ufunc, method)(*(_plain(value) for value in inputs), **arguments)

    def __array_function__(self, function: Any, types: Any, arguments: Any, named: Any) -> Any:
        return super().__array_function__(function, types, _all_plain(arguments), _all_plain(named))

    def __getitem__(self, index: Any) -> Any:
        return np.asarray(self)[index]

    def __reduce__(self) -> Any:
        return np.asarray(self).__reduce__()

    def __copy__(self) -> Any:
        return np.array(self)

    def __deepcopy__(self, memo: Any, /) -> Any:
        return np.array(self)

    def __repr__(self) -> str:
        return repr(np.asarray(self))

    def __str__(self) -> str:
        return str(np.asarray(self))


def _plain(value: Any) -> Any:
    return np.asarray(value) if isinstance(value, Normals) else value


def _all_plain(values: Any) -> Any:
    """Return arguments of a function with plain arrays in place of normals, also within lists."""
    if isinstance(values, dict):
        return {name: _all_plain(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return type(values)(_all_plain(value) for value in values)
    return _plain(values)
