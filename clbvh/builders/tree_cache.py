"""Trees that are kept for later runs: one file per mesh and set of build options.

Owns the names of the files. Their content, which is not trusted, belongs to `bvh.serialize`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from importlib.metadata import version
from pathlib import Path

from ..bvh import Bvh
from ..errors import ConfigError, TreeFileError
from ..geometry import Mesh
from ..support.cache_folder import find_cache
from .options import BuildOptions

SUFFIX = ".tree"

# Hexadecimal digits in a file's name. Collisions do no harm: the file holds the whole fingerprint.
_MESH_DIGITS = 32
_RECIPE_DIGITS = 16


def find_tree_cache() -> Path:
    """Return the folder for trees in the user's cache: in `CLBVH_CACHE`, or in the system's folder for caches."""
    return find_cache() / "trees"


def make_folder(folder: Path) -> None:
    """Create the folder of a cache; raise `ConfigError` if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: trees cannot be kept in this folder: {error.strerror or error}") from error


def cache_path(folder: Path, mesh: Mesh, builder: str, options: BuildOptions) -> Path:
    """Return the path for the tree of a mesh.

    The name identifies the mesh, by its fingerprint, and everything that determines the tree: the builder, its options
    without the task threshold, and the version of clbvh.
    """
    recipe = dataclasses.asdict(options) | {"builder": builder, "version": version("clbvh")}
    del recipe["task_threshold"]
    digest = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    return folder / f"{mesh.fingerprint.hex()[:_MESH_DIGITS]}-{digest[:_RECIPE_DIGITS]}{SUFFIX}"


def take_tree(path: Path, mesh: Mesh) -> tuple[Bvh | None, str]:
    """Return the tree in a file, or None and the reason in one sentence, which is empty if there is no such file."""
    if not path.exists():
        return None, ""
    try:
        return Bvh.load(path, mesh), ""
    except TreeFileError as error:
        return None, f"the tree in the cache cannot be used and is built again: {error}"


def keep_tree(path: Path, bvh: Bvh) -> str:
    """Write a tree into its file; return the reason of a failure in one sentence, empty without one."""
    try:
        bvh.save(path)
    except (OSError, ConfigError) as error:
        return f"the tree cannot be kept in the cache: {error}"
    return ""
