"""The exception classes, all of them under `ClbvhError`.

Bad input is a `ValueError`, a machine that cannot do the work is a `RuntimeError`, and a broken invariant of clbvh is
an `InternalError`: the three never share a path. A message is one sentence with the given value, the expected one and
a remedy.
"""

from __future__ import annotations


class ClbvhError(Exception):
    """Base class of all errors that clbvh raises.

    Examples
    --------
    >>> import clbvh
    >>> try:
    ...     clbvh.load_mesh("missing.ply")
    ... except clbvh.ClbvhError as error:
    ...     print(type(error).__name__, "-", isinstance(error, ValueError))
    MeshError - True
    """


class MeshError(ClbvhError, ValueError):
    """A mesh or a mesh file cannot be used.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.Mesh.from_arrays([[0, 0, 0]], [[0, 0, 1]])
    Traceback (most recent call last):
    clbvh.errors.MeshError: mesh: face 0 refers to vertex 1, but there are 1 vertices (0 to 0)
    """


class SceneError(ClbvhError, ValueError):
    """A scene or a scene file cannot be rendered.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.Camera(eye=(0, 0, 1), look_at=(0, 0, 1))
    Traceback (most recent call last):
    clbvh.errors.SceneError: the camera's eye and look_at are the same point
    """


class TreeFileError(ClbvhError, ValueError):
    """A saved tree cannot be used: its file is damaged, of another format, or belongs to another mesh.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.Bvh.load("missing.tree", clbvh.make_shape("icosphere", triangles=1000))
    Traceback (most recent call last):
    clbvh.errors.TreeFileError: ...
    """


class ConfigError(ClbvhError, ValueError):
    """An option or an argument has a value outside its range.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.BuildOptions(bins=1)
    Traceback (most recent call last):
    clbvh.errors.ConfigError: bins must be a whole number from 2 to 64, or None, not 1
    """


class QueryError(ClbvhError, ValueError):
    """Rays, points or limits of a query cannot be used, or its tracer is closed.

    Examples
    --------
    >>> import clbvh
    >>> tracer = clbvh.Tracer(clbvh.make_shape("icosphere", triangles=1000))
    >>> tracer.any_hit([[0, 0, 5]], [[0, 0, 0]])
    Traceback (most recent call last):
    clbvh.errors.QueryError: ...
    """


class DeviceError(ClbvhError, RuntimeError):
    """No device can do the work, or the chosen one failed.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.choose_device("no such device")
    Traceback (most recent call last):
    clbvh.errors.DeviceError: ...
    """


class DeviceMemoryError(DeviceError):
    """A device has no memory for a buffer or a launch, also after the work has been cut into small pieces.

    Examples
    --------
    >>> import clbvh
    >>> issubclass(clbvh.DeviceMemoryError, clbvh.DeviceError)
    True
    """


class KernelBuildError(ClbvhError, RuntimeError):
    """A kernel did not compile.

    Parameters
    ----------
    device : str
        Name of the device whose compiler failed.
    options : str
        The options given to the compiler.
    log : str
        The compiler's output, with the file names and line numbers of clbvh.

    Examples
    --------
    >>> import clbvh
    >>> error = clbvh.KernelBuildError("a device", "-cl-std=CL1.2", "cast.cl:7: no such type")
    >>> print(error)
    the kernel does not compile on a device with options '-cl-std=CL1.2':
    cast.cl:7: no such type
    """

    def __init__(self, device: str, options: str, log: str) -> None:
        super().__init__(device, options, log)
        self.device = device
        self.options = options
        self.log = log

    def __str__(self) -> str:
        return f"the kernel does not compile on {self.device} with options '{self.options}':\n{self.log}"


class FetchError(ClbvhError, RuntimeError):
    """A download failed, or its content is not the expected one.

    Examples
    --------
    >>> import clbvh
    >>> issubclass(clbvh.FetchError, RuntimeError)  # not the caller's fault
    True
    """


class PoolError(ClbvhError, RuntimeError):
    """A worker process failed or ended, or there is no memory to share with it.

    Examples
    --------
    >>> import clbvh
    >>> pool = clbvh.SubtreePool(workers=1)
    >>> pool.close()
    >>> clbvh.build(clbvh.make_shape("icosphere", triangles=30_000), pool=pool)
    Traceback (most recent call last):
    clbvh.errors.PoolError: ...
    """


class ValidationError(ClbvhError, RuntimeError):
    """A tree or a picture differs from the result of a slow, independent check.

    Examples
    --------
    >>> import clbvh
    >>> from dataclasses import replace
    >>> bvh = clbvh.build(clbvh.make_shape("icosphere", triangles=1000))
    >>> clbvh.validate_tree(replace(bvh, nodes=bvh.nodes[:0]))
    Traceback (most recent call last):
    clbvh.errors.ValidationError: a tree over 980 triangles cannot have 0 nodes
    """


class ClbvhWarning(UserWarning):
    """Base class of all warnings of clbvh.

    Examples
    --------
    >>> import clbvh
    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", clbvh.ClbvhWarning)
    ...     mesh = clbvh.make_shape("icosphere", triangles=1000)
    """


class AppearanceWarning(ClbvhWarning):
    r"""Colours, normals, texture coordinates, materials or textures of a file cannot be used; its triangles can.

    Examples
    --------
    >>> import clbvh
    >>> import tempfile
    >>> import warnings
    >>> from pathlib import Path
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name, "triangle.obj")
    >>> _ = path.write_text("mtllib lost.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     mesh = clbvh.load_mesh(path)
    >>> [warning.category.__name__ for warning in caught]
    ['AppearanceWarning']
    >>> folder.cleanup()
    """


class OpenMeshWarning(ClbvhWarning):
    """A query about the inside of a mesh that is not closed, or whose faces coincide in a way that closes nothing.

    Examples
    --------
    >>> import clbvh
    >>> import warnings
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     inside = clbvh.Tracer(square).contains([[0.5, 0.5, 1]])
    >>> [warning.category.__name__ for warning in caught]
    ['OpenMeshWarning']
    """


class InternalError(ClbvhError, RuntimeError):
    """A bug of clbvh itself: an invariant does not hold.

    Examples
    --------
    >>> import clbvh
    >>> issubclass(clbvh.InternalError, clbvh.ClbvhError)
    True
    """


def shorten_message(message: object) -> str:
    """Return what a library says as one line of at most 200 characters."""
    return " ".join(str(message).split())[:200]
