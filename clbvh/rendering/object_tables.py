"""The `[[object]]` tables of a scene file become `SceneObject` values.

Owns the keys of an object and the rules between objects: labels, scatters, the number of copies. Nothing is loaded
here, and no memory is taken that the file does not already take.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, SceneError
from ..geometry.appearance.material import Material
from ..geometry.shapes.make_shape import list_shape_options
from ..geometry.shapes.make_spheres import list_spheres_options
from .objects import ALL_BITS, Grid, Scatter, SceneObject, SpheresSource, check_copies, is_spheres_file
from .scene import MeshSource
from .sources import Transform
from .toml_tables import NO_MATERIALS, Materials, TomlTable, take_material
from .vectors import read_matrix

_SOURCES = ("path", "name", "shape", "spheres", "centres")


def read_objects(tables: Any, folder: Path, materials: Materials = NO_MATERIALS) -> tuple[SceneObject, ...]:
    """Return the objects of a scene file.

    Parameters
    ----------
    tables : list of dict
        The value of the key ``object``, as `tomllib` reads it.
    folder : Path
        Of the scene file: paths of objects count from there.
    materials : Mapping of str to Material
        By label, as `read_materials` returns them.

    Raises
    ------
    SceneError
        An unknown key, an invalid value, two objects of one label, a scatter on something that is no mesh placed once
        above, or too many copies.
    """
    if not isinstance(tables, list) or not tables or not all(isinstance(values, dict) for values in tables):
        raise SceneError("objects are tables of their own: write [[object]] above the keys of each")
    objects: list[SceneObject] = []
    for number, values in enumerate(tables, 1):
        table = TomlTable(f"[object {number}]", values)
        found = _read_object(table, folder, materials)
        objects.append(_with_label(found, objects, table.name))
        if isinstance(found.repeat, Scatter):
            _check_target(found.repeat.on, objects[:-1], table.name)
    check_copies(sum(found.count for found in objects))
    return tuple(objects)


def find_object(label: str, objects: list[SceneObject] | tuple[SceneObject, ...]) -> SceneObject | None:
    """Return the object of a label, None if there is none."""
    return next((found for found in objects if found.label == label), None)


def read_mesh_source(table: TomlTable, folder: Path, material: Material | None = None) -> MeshSource:
    """Take the source of a mesh in a material, and refuse the keys that are left."""
    path, name, shape = table.text("path"), table.text("name"), table.text("shape")
    source: dict[str, Any] = {"path": None if path is None else str(folder / path), "name": name, "shape": shape}
    source["material"] = material
    if shape is None:
        table.refuse_rest()
        return MeshSource(**source)
    numbers = given(triangles=table.integer("triangles"), seed=table.integer("seed"))
    return MeshSource(**source, **numbers, options=table.rest_as_numbers(list_shape_options(shape)))


def read_transform(table: TomlTable) -> Transform:
    """Take scale, rotation and translation."""
    return Transform(
        **given(
            scale=table.number_or_vector("scale"),
            rotate=table.vector("rotate"),
            translate=table.vector("translate"),
        )
    )


def given(**values: Any) -> dict[str, Any]:
    """Return the values that are not None."""
    return {key: value for key, value in values.items() if value is not None}


def _read_object(table: TomlTable, folder: Path, materials: Materials) -> SceneObject:
    """Return one object; its label is empty where the table has none."""
    try:
        return SceneObject(
            label=_read_label(table),
            colour=table.vector("colour"),
            mask=_read_mask(table),
            material=take_material(table, materials),
            matrix=_read_placement(table),
            repeat=_read_repeat(table),
            source=_read_source(table, folder),
        )
    except (ConfigError, SceneError) as error:
        text = str(error)
        raise SceneError(text if text.startswith("[") else f"{table.name} {text}") from None


def _read_label(table: TomlTable) -> str:
    label = table.text("label")
    if label is not None and not label.strip():
        raise SceneError("the label must not be empty")
    return label or ""


def _read_mask(table: TomlTable) -> int:
    mask = table.integer("mask")
    if mask is not None and not 0 <= mask <= ALL_BITS:
        raise SceneError(f"the mask must be 32 bits, 0 to {ALL_BITS}, not {mask}")
    return ALL_BITS if mask is None else mask


def _read_placement(table: TomlTable) -> NDArray[np.float64]:
    is_split = any(key in table for key in ("scale", "rotate", "translate"))
    transform, rows = read_transform(table), table.rows("matrix", 4, 4)
    if rows is None:
        return transform.matrix
    if is_split:
        raise SceneError("a matrix stands for scale, rotate and translate: leave those out, or the matrix")
    return read_matrix("the matrix", rows, (4, 4))


def _read_repeat(table: TomlTable) -> Grid | Scatter | None:
    repeat = table.table("repeat")
    if repeat is None:
        return None
    if ("grid" in repeat) == ("on" in repeat):
        raise SceneError(f"{repeat.name} needs either 'grid' and 'spacing', or 'on' and 'count'")
    if "grid" in repeat:
        counts, spacing = repeat.integers("grid", 3), repeat.vector("spacing")
        repeat.refuse_rest()
        if counts is None or spacing is None:
            raise SceneError(f"{repeat.name} needs 'spacing' beside 'grid'")
        return Grid((counts[0], counts[1], counts[2]), spacing)
    on, count, scale = repeat.text("on"), repeat.integer("count"), repeat.numbers("scale")
    if on is None or count is None:
        raise SceneError(f"{repeat.name} needs 'count' beside 'on'")
    values: dict[str, Any] = given(
        seed=repeat.integer("seed"), align=repeat.text("align"), turn=repeat.flag("turn"), scale=scale
    )
    repeat.refuse_rest()
    if isinstance(scale, list) and len(scale) != 2:
        raise SceneError(f"{repeat.name} scale must be one number, or the smallest and the largest, not {len(scale)}")
    if scale is not None:
        values["scale"] = tuple(scale) if isinstance(scale, list) else (scale, scale)
    return Scatter(on, count, **values)


def _read_source(table: TomlTable, folder: Path) -> MeshSource | SpheresSource:
    """Take the source, which is last: all keys that are left belong to a shape, or are unknown."""
    chosen = [key for key in _SOURCES if key in table]
    if len(chosen) != 1:
        raise SceneError(f"needs exactly one of {', '.join(_SOURCES)}, not {' and '.join(chosen) or 'none of them'}")
    if chosen[0] not in ("spheres", "centres"):
        return read_mesh_source(table, folder)
    spheres, centres, radii = table.text("spheres"), table.rows("centres", 3), table.numbers("radii")
    values: dict[str, Any] = {"radii": tuple(radii) if isinstance(radii, list) else radii}
    if spheres is None:
        values["centres"] = tuple(map(tuple, centres or ()))
    elif is_spheres_file(spheres):
        values["path"] = str(folder / spheres)
    else:
        if radii is not None:
            raise SceneError(f"the spheres '{spheres}' have radii of their own: leave 'radii' out")
        numbers = given(count=table.integer("count"), seed=table.integer("seed"))
        values |= {"generator": spheres, **numbers, "options": table.rest_as_numbers(list_spheres_options(spheres))}
    table.refuse_rest()
    return SpheresSource(**values)


def _with_label(found: SceneObject, others: list[SceneObject], where: str) -> SceneObject:
    """Return the object with a label of its own: the given one, or the source's name, numbered where it is taken."""
    if found.label:
        if find_object(found.label, others):
            raise SceneError(f"{where} has the label '{found.label}' of another object: labels are given once")
        return found
    source = found.source
    base = (
        source.name if isinstance(source, SpheresSource) else source.shape or source.name or Path(str(source.path)).stem
    )
    label, number = str(base), 1
    while find_object(label, others):
        number += 1
        label = f"{base} {number}"
    return dataclasses.replace(found, label=label)


def _check_target(label: str, others: list[SceneObject], where: str) -> None:
    """Raise `SceneError` unless copies can be scattered on the object of this label."""
    target = find_object(label, others)
    if target is None:
        known = ", ".join(f"'{found.label}'" for found in others) or "none"
        raise SceneError(f"{where} is scattered on '{label}', but no object above it has this label: there are {known}")
    if target.repeat is not None or isinstance(target.source, SpheresSource):
        raise SceneError(f"{where} is scattered on '{label}', which must be a mesh that is placed once")
