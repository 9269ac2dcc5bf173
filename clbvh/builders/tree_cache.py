"""Trees that are kept for the next run: one file for each mesh and way to build.

Owns the names of the files. What is in them, and that nothing in them is trusted, is the business of `tree.store`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from importlib.metadata import version
from pathlib import Path

from ..build import BuildOptions
from ..errors import ConfigError, TreeFileError
from ..geometry import Mesh
from ..geometry.known import find_cache
from ..tree import Bvh

SUFFIX = ".tree"

# Hexadecimal digits in a file's name. They need not be safe against forgery: the file has the whole fingerprint.
_MESH_DIGITS = 32
_RECIPE_DIGITS = 16


def find_tree_cache() -> Path:
    """Return the folder for trees in the user's cache: in `CLBVH_CACHE`, or in the one for caches of this system."""
    return find_cache() / "trees"


def make_folder(folder: Path) -> None:
    """Make the folder of a cache; raise `ConfigError` where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: trees cannot be kept in this folder: {error.strerror or error}") from error


def cache_path(folder: Path, mesh: Mesh, builder: str, options: BuildOptions) -> Path:
    """Return where the tree of a mesh is kept.

    The name says the mesh, by its fingerprint, and everything that decides about the tree: the builder, its options
    without the task threshold, and the version of clbvh.
    """
    recipe = dataclasses.asdict(options) | {"builder": builder, "version": version("clbvh")}
    del recipe["task_threshold"]
    digest = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    return folder / f"{mesh.fingerprint.hex()[:_MESH_DIGITS]}-{digest[:_RECIPE_DIGITS]}{SUFFIX}"


def take_tree(path: Path, mesh: Mesh) -> tuple[Bvh | None, str]:
    """Return the tree that is kept in a file, or none and why not: one sentence, empty when there is no such file."""
    if not path.exists():
        return None, ""
    try:
        return Bvh.load(path, mesh), ""
    except TreeFileError as error:
        return None, f"the tree in the cache cannot be used, and is built again: {error}"


def keep_tree(path: Path, bvh: Bvh) -> str:
    """Put a tree into its file; return why that failed, one sentence, or nothing."""
    try:
        bvh.save(path)
    except (OSError, ConfigError) as error:
        return f"the tree cannot be kept in the cache: {error}"
    return ""
