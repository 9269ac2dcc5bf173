"""The well-known meshes: how they are found on this machine, and how they are downloaded.

Owns the table of their names and their place in the cache. Must not know how a mesh file is read.

The meshes come from the Stanford 3D Scanning Repository, Stanford Computer Graphics Laboratory; their use is free for
research, with credit.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import tarfile
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError, FetchError, MeshError
from ..support.files import temporary_folder
from ..support.folders import find_cache

STANFORD = "https://graphics.stanford.edu/pub/3Dscanrep"

MESHES_VARIABLE = "CLBVH_MESHES"

_TIMEOUT_S = 30


@dataclass(frozen=True)
class KnownMesh:
    """A known mesh, and the archive that holds it.

    Attributes
    ----------
    name : str
        The name by which users ask for it.
    archive : str
        The archive's path below the repository's address.
    member : str
        The path of the mesh in the archive.
    archive_sha256, member_sha256 : str or None
        Checksums of the two; at least one is known.
    alternatives : tuple of str
        Other file names under which the user's folder may hold the mesh.
    """

    name: str
    archive: str
    member: str
    archive_sha256: str | None = None
    member_sha256: str | None = None
    alternatives: tuple[str, ...] = ()

    @property
    def file_name(self) -> str:
        """The name of the file in the cache."""
        return self.member.rsplit("/", 1)[-1]


KNOWN_MESHES = {
    mesh.name: mesh
    for mesh in (
        KnownMesh(
            "bunny",
            "bunny.tar.gz",
            "bunny/reconstruction/bun_zipper.ply",
            archive_sha256="a5720bd96d158df403d153381b8411a727a1d73cff2f33dc9b212d6f75455b84",
        ),
        KnownMesh(
            "dragon",
            "dragon/dragon_recon.tar.gz",
            "dragon_recon/dragon_vrip.ply",
            archive_sha256="74ac1d90989c9b1732edee82d57e9ce71452144cf4355f108d8c9c616d28d02f",
            alternatives=("dragon_871k.ply",),
        ),
        KnownMesh(
            "drill",
            "drill.tar.gz",
            "drill/reconstruction/drill_shaft_zip.ply",
            member_sha256="b47bef76b4a890b8e7186eb3abdb28c137ae1804f1a31bcd8ded26405159b84e",
        ),
    )
}


def get_known_mesh(name: str) -> KnownMesh:
    """Return the known mesh of a name; raise `ConfigError` when there is none."""
    try:
        return KNOWN_MESHES[name]
    except KeyError:
        raise ConfigError(f"there is no known mesh '{name}': the known ones are {', '.join(KNOWN_MESHES)}") from None


def find_known_mesh(name: str) -> Path:
    """Find the file of a known mesh: in the folder `CLBVH_MESHES`, then in the cache.

    Parameters
    ----------
    name : str
        `bunny`, `dragon` or `drill`.

    Returns
    -------
    Path

    Raises
    ------
    ConfigError
        No mesh is known by that name.
    MeshError
        It is in neither; the message says how to get it.
    """
    mesh = get_known_mesh(name)
    if folder := os.environ.get(MESHES_VARIABLE):
        for file_name in (mesh.file_name, *mesh.alternatives, f"{mesh.name}.ply"):  # best first
            if (path := Path(folder) / file_name).is_file():
                return path
    if (path := find_cache() / mesh.file_name).is_file():
        return path
    where = f"{MESHES_VARIABLE} is {folder}" if folder else f"{MESHES_VARIABLE} is not set"
    raise MeshError(
        f"the mesh '{name}' is not on this machine: run 'clbvh fetch {name}', or set {MESHES_VARIABLE} to a folder "
        f"that has {mesh.file_name} ({where})"
    )


def fetch_mesh(name: str, *, base_url: str = STANFORD, progress: Any = None) -> Path:
    """Return the file of a known mesh, which is downloaded into the cache unless `find_known_mesh` finds it.

    Parameters
    ----------
    name : str
        `bunny`, `dragon` or `drill`.
    base_url : str, optional
        Address of the repository, or of a mirror with the same paths.
    progress : object, optional
        A progress bar as pooch takes it: with `total`, `update`, `reset` and `close`.

    Returns
    -------
    Path
        A download appears in the cache complete or not at all.

    Raises
    ------
    ConfigError
        No mesh is known by that name.
    FetchError
        The download failed or was cut off, a checksum is wrong, or the archive lacks the mesh. No file is left behind.
    """
    mesh = get_known_mesh(name)
    with suppress(MeshError):
        return find_known_mesh(name)
    cache = find_cache()
    target = cache / mesh.file_name
    url = f"{base_url.rstrip('/')}/{mesh.archive}"
    try:
        cache.mkdir(parents=True, exist_ok=True)
        # A folder that is removed with its content, whatever happens.
        with temporary_folder(cache, f".{name}-") as work:
            extracted = work / mesh.file_name
            extracted.write_bytes(_extract(_download(url, mesh, work, progress), mesh, url))
            extracted.replace(target)
    except OSError as error:
        raise FetchError(f"{url}: cannot be stored in {cache}: {error.strerror or error}") from error
    return target


def _download(url: str, mesh: KnownMesh, folder: Path, progress: Any) -> Path:
    """Download the archive into a folder and check its checksum, if that is known."""
    # Imported here: this takes 0.2 s, and only a download needs them.
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    downloader = pooch.HTTPDownloader(progressbar=progress or False, timeout=_TIMEOUT_S, allow_redirects=True)
    known_hash = mesh.archive_sha256 and f"sha256:{mesh.archive_sha256}"
    try:
        return Path(pooch.retrieve(url, known_hash, "archive.tar.gz", folder, downloader=downloader))
    except requests.RequestException as error:
        if error.response is None:
            raise FetchError(f"{url}: the connection failed or was cut ({type(error).__name__}): try again") from error
        error.response.close()  # pooch leaves the connection open when the status is bad
        answer = f"{error.response.status_code} {error.response.reason}"
        raise FetchError(f"{url}: the server answers {answer}") from error
    except ValueError as error:
        raise FetchError(f"{url}: the archive is not the known one, or was damaged on its way: {error}") from error


def _extract(archive: Path, mesh: KnownMesh, url: str) -> bytes:
    """Return the mesh in the archive, after a check of its checksum, if that is known."""
    try:
        with tarfile.open(archive, "r:gz") as tar:
            source = tar.extractfile(mesh.member)
            content = source.read() if source is not None else b""
    except KeyError as error:
        raise FetchError(f"{url}: the archive has no '{mesh.member}'") from error
    except (tarfile.TarError, gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise FetchError(f"{url}: the archive is damaged or was cut off ({error}): try again") from error
    digest = hashlib.sha256(content).hexdigest()
    if not content or mesh.member_sha256 not in (None, digest):
        raise FetchError(
            f"{url}: '{mesh.member}' is not the known mesh, or was damaged on its way: its sha256 is {digest} instead "
            f"of {mesh.member_sha256}"
        )
    return content
