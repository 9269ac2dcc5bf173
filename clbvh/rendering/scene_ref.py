"""A scene by its name: the path and the hash of a file, or its bytes. It opens where it arrives, once per process."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ..builders.build import plan_trees, suit_options
from ..builders.options import FAST_QUALITY, BuildOptions
from ..builders.tree_cache import find_tree_cache, get_trees
from ..builders.tree_options import TreeOptions
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..errors import SceneError
from ..files.open_scene import SceneLike, as_scene, open_scene
from ..files.scene_file import save_scene
from ..geometry import Shape
from ..scene.scene import Scene
from ..scene.state import SAVED_SCENE
from ..support.archive import begins_with_member
from ..support.files import open_regular, read_errors_as
from ..support.folders import is_writable
from ..support.opened import open_once
from ..trace.tracer import Opening, Tracer
from ..trace.world.trees import check_fit
from ..views.view import View
from .options import RenderOptions
from .renderer import Renderer

# Files that name no others: their bytes are the scene. Saved scenes are such files, too.
_WHOLE_FILES = (".ply", ".stl", ".off", ".glb")


@dataclass(frozen=True)
class SceneRef:
    """A scene by the path and the hash of its file: about 200 bytes that go to other processes in place of the scene.

    Where it arrives, `tracer` opens the file, once for each process, and refuses one with another content. Two scenes
    are kept open in a process.

    Parameters
    ----------
    path : str or path
        A mesh file, a saved scene, a scene file (``.toml``) or the name of a shipped scene. Processes elsewhere find
        the file by the same absolute path.
    sha256 : str, optional
        Of the file. Of a scene file, and of OBJ and glTF files, which name other files: of all that they name, as
        `save_scene` saves it; then the file is loaded for it. Found where the reference is made, if it is left out.
    content : bytes, optional
        A saved scene, in place of the file; see `embed`.

    Raises
    ------
    SceneError, MeshError
        The file cannot be read, or is no scene.

    Examples
    --------
    >>> import clbvh
    >>> import pickle
    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name, "ball.scene")
    >>> clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).save(path)
    >>> ref = clbvh.SceneRef(path)
    >>> len(pickle.dumps(ref)) < 300
    True
    >>> with pickle.loads(pickle.dumps(ref)).tracer() as tracer:
    ...     tracer.any_hit([0, 0, 5], [0, 0, -1])
    array(True)
    >>> folder.cleanup()
    """

    path: str | os.PathLike[str]
    sha256: str = ""
    content: bytes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        with read_errors_as(SceneError, self.path):
            is_file = Path(self.path).is_file()
        path = str(Path(self.path).absolute()) if is_file else os.fspath(self.path)
        vars(self).update(path=path, sha256=self.sha256 or _read(path)[0])

    @classmethod
    def embed(cls, source: SceneLike | list[str]) -> SceneRef:
        """Return a reference that carries the scene itself, for processes that do not share a disk.

        Parameters
        ----------
        source : SceneLike
            See `Renderer`. Trees are built where they arrive.

        Raises
        ------
        SceneError, MeshError
            The input cannot be used.

        Examples
        --------
        >>> import clbvh
        >>> ref = clbvh.SceneRef.embed(clbvh.make_shape("icosphere", triangles=320))
        >>> ref.tracer().any_hit([0, 0, 5], [0, 0, -1])
        array(True)
        """
        scene, view = as_scene(source)
        content = _save(scene, view)
        return cls("the scene of a SceneRef", hashlib.sha256(content).hexdigest(), content)

    def load(self) -> tuple[Scene, View]:
        """Return the scene and its view, as `open_scene` does.

        Raises
        ------
        SceneError, MeshError
            The file is missing, has another content than it had, or cannot be read.

        Examples
        --------
        >>> import clbvh
        >>> scene, view = clbvh.SceneRef("knot").load()
        >>> scene.instances, view.width
        ((Instance(0, 'knot', of='knot'),), 800)
        """
        if self.content is not None:
            with _temporary_path() as path:
                path.write_bytes(self.content)
                return open_scene(path)
        found, loaded = _read(str(self.path))
        if found != self.sha256:
            raise SceneError(
                f"{self.path}: the file, or one that it names, has another content here than where the reference was "
                f"made (SHA-256 {found[:12]}..., not {self.sha256[:12]}...): copy it here, or make a new reference"
            )
        return loaded or open_scene(self.path)

    def tracer(
        self, *, device: DeviceInfo | str | int | None = None, layout: str = "auto", quality: str = "default"
    ) -> Tracer:
        """Return a tracer of the scene, which this process opens once for these arguments, and keeps for later calls.

        Its changes and its end are its own. Trees of the qualities ``"default"`` and ``"high"`` come from the folder
        for trees in the user's cache, and are kept there, as by ``clbvh render --cache``.

        Parameters
        ----------
        device, layout, quality : optional
            See `Tracer`.

        Raises
        ------
        SceneError, MeshError
            See `load`.
        DeviceError, ConfigError
            See `Tracer`.

        Examples
        --------
        >>> import clbvh
        >>> ref = clbvh.SceneRef.embed(clbvh.make_shape("icosphere", triangles=320))
        >>> first, second = ref.tracer(), ref.tracer()
        >>> first.close()
        >>> second.any_hit([0, 0, 5], [0, 0, -1])
        array(True)
        """
        kept = open_tracer(self, device, layout, quality)
        return kept._twin(kept._opening.scene)

    def __dask_tokenize__(self) -> object:
        return type(self).__name__, self.path, self.sha256


def open_tracer(
    ref: SceneRef, device: DeviceInfo | str | int | None = None, layout: str = "auto", quality: str = "default"
) -> Tracer:
    """Return the tracer that the process keeps open for `SceneRef.tracer`: for queries, not to be changed or closed."""

    def open_anew() -> Tracer:
        scene, _ = ref.load()
        state = scene.snapshot()
        check_fit(device, layout, state.shapes)
        opening = Opening(scene, state, None, device, layout, quality, ref)
        return Tracer._opened(opening, _find_trees(state.shapes, quality))

    return open_once((ref.sha256, repr(device), layout, quality), open_anew)


def open_renderer(ref: SceneRef, options: RenderOptions | None = None) -> Renderer:
    """Return a renderer that the process keeps open: not to be closed."""
    wanted = options or RenderOptions(cache=_find_cache())
    return open_once((ref.sha256, repr(wanted)), lambda: Renderer(*ref.load(), wanted))


def _find_trees(shapes: Sequence[Shape], quality: str) -> Sequence[Bvh | BuildOptions]:
    if quality == FAST_QUALITY:
        return plan_trees(shapes, quality)
    return get_trees(shapes, lambda shape: TreeOptions(build=suit_options(shape, quality), cache=_find_cache())).bvhs


def _find_cache() -> Path | None:
    folder = find_tree_cache()
    return folder if is_writable(folder) else None


def _read(path: str) -> tuple[str, tuple[Scene, View] | None]:
    """Return the hash of a file, and its scene where that is needed for it."""
    if Path(path).suffix.lower() in _WHOLE_FILES or begins_with_member(path, SAVED_SCENE):
        with read_errors_as(SceneError, path), open_regular(Path(path)) as file:
            return hashlib.file_digest(file, "sha256").hexdigest(), None
    loaded = open_scene(path)
    return hashlib.sha256(_save(*loaded)).hexdigest(), loaded


def _save(scene: Scene, view: View) -> bytes:
    with _temporary_path() as path:
        save_scene(path, scene, view)
        return path.read_bytes()


@contextmanager
def _temporary_path() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="clbvh-") as folder:
        yield Path(folder, "scene")
