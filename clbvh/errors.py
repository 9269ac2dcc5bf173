"""The exception classes, all of them under `ClbvhError`.

Bad input is a `ValueError`, a machine that cannot do the work is a `RuntimeError`, and a broken invariant of clbvh is
an `InternalError`: the three never share a path. A message is one sentence with the given value, the expected one and
a remedy.
"""

from __future__ import annotations


class ClbvhError(Exception):
    """Anything that clbvh raises on purpose."""


class MeshError(ClbvhError, ValueError):
    """A mesh or a mesh file cannot be used."""


class SceneError(ClbvhError, ValueError):
    """A scene or a scene file cannot be rendered."""


class TreeFileError(ClbvhError, ValueError):
    """A saved tree cannot be used: its file is damaged, of another format, or belongs to another mesh."""


class ConfigError(ClbvhError, ValueError):
    """An option or an argument has a value outside its range."""


class QueryError(ClbvhError, ValueError):
    """Rays, points or limits of a query cannot be used, or its tracer is closed."""


class DeviceError(ClbvhError, RuntimeError):
    """No OpenCL device can do the work, or the chosen one failed."""


class DeviceMemoryError(DeviceError):
    """A device has no memory for a buffer or a launch, also after the work has been cut into small pieces."""


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
    """

    def __init__(self, device: str, options: str, log: str) -> None:
        super().__init__(device, options, log)
        self.device = device
        self.options = options
        self.log = log

    def __str__(self) -> str:
        return f"the kernel does not compile on {self.device} with options '{self.options}':\n{self.log}"


class FetchError(ClbvhError, RuntimeError):
    """A download failed, or its content is not the expected one."""


class PoolError(ClbvhError, RuntimeError):
    """A worker process failed, ended or stopped answering, or there is no memory to share with it."""


class ValidationError(ClbvhError, RuntimeError):
    """A tree or a picture differs from the result of a slow, independent check."""


class OpenMeshWarning(UserWarning):
    """A question about inside and outside is put to a mesh that encloses no volume."""


class InternalError(ClbvhError, RuntimeError):
    """A bug of clbvh itself: an invariant does not hold."""
