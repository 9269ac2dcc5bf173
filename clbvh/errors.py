"""The exception classes, all of them under `ClbvhError`.

Bad input is a `ValueError`, a machine that cannot do the work is a `RuntimeError`, and a broken invariant of our
own is an `InternalError`: the three never share a path. A message is one sentence that says what was given, what
was expected and what to do.
"""

from __future__ import annotations


class ClbvhError(Exception):
    """Anything that clbvh raises on purpose."""


class MeshError(ClbvhError, ValueError):
    """A mesh, or the file it should come from, cannot be used."""


class SceneError(ClbvhError, ValueError):
    """A scene file says something that cannot be rendered."""


class TreeFileError(ClbvhError, ValueError):
    """A saved tree cannot be used: its file is damaged, of another format, or belongs to another mesh."""


class ConfigError(ClbvhError, ValueError):
    """An option or an argument has a value outside its range."""


class DeviceError(ClbvhError, RuntimeError):
    """No OpenCL device can do the work, or the one that was chosen failed."""


class KernelBuildError(ClbvhError, RuntimeError):
    """A kernel did not compile.

    Parameters
    ----------
    device : str
        Name of the device whose compiler refused.
    options : str
        The options the compiler was given.
    log : str
        The compiler's own words, with our file names and line numbers.
    """

    def __init__(self, device: str, options: str, log: str) -> None:
        super().__init__(device, options, log)
        self.device = device
        self.options = options
        self.log = log

    def __str__(self) -> str:
        return f"the kernel does not compile on {self.device} with options '{self.options}':\n{self.log}"


class FetchError(ClbvhError, RuntimeError):
    """A download failed, or what came is not what was wanted."""


class PoolError(ClbvhError, RuntimeError):
    """A worker process failed, died or fell silent, or there is no memory to share with it."""


class ValidationError(ClbvhError, RuntimeError):
    """A tree or a picture differs from what the slow, independent check expects."""


class InternalError(ClbvhError, RuntimeError):
    """A bug of clbvh itself: an invariant does not hold."""
