"""The folders of the files that ship with clbvh: kernel sources and scenes.

A wheel carries them inside the package; a source checkout and an editable install have them one folder up.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import InternalError

_PACKAGE = Path(__file__).resolve().parents[1]


def find_folder(name: str) -> Path:
    """Return the shipped folder `name`: the packaged copy first, then the one of the source checkout.

    Parameters
    ----------
    name : str
        ``"cl"`` or ``"scenes"``.

    Raises
    ------
    InternalError
        Neither exists: the installation is broken.
    """
    candidates = (_PACKAGE / name, _PACKAGE.parent / name)
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise InternalError(
        f"the shipped folder '{name}' is in neither {candidates[0]} nor {candidates[1]}: reinstall clbvh"
    )
