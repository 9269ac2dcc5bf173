"""A view as text: the command `clbvh render`, and the Python, of the same picture."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from typing import Any

from ..errors import ConfigError
from ..files.scene_file import plain_view
from ..support.settings import Setting, list_settings, settings_of
from ..views.cameras.projection import Projection, text_of
from ..views.cut import Cut
from ..views.environment_map import EnvironmentMap
from ..views.view import View


def phrase_command(sources: Sequence[str], own: View, view: View) -> str:
    """Return the command that renders a view.

    Parameters
    ----------
    sources : sequence of str
        The names of files, or of a scene.
    own : View
        That of a scene file, whose settings hold where the command says nothing.
    view : View

    Raises
    ------
    ConfigError
        There are no files, or an option cannot say a setting.
    """
    if not sources:
        raise ConfigError("what is shown has no file that a command could name: copy the Python")
    changes: dict[str, Any] = {}
    if (view.wireframe is None) != (own.wireframe is None):
        changes["wireframe"] = view.wireframe is not None
    begin = own.changed(**changes)
    for each in list_settings(View):
        value = _get(view, each)
        has_text = value is not None and not (isinstance(value, EnvironmentMap) and value.path is None)
        if has_text and each.is_option and each.kind.members is None and value != _get(begin, each):
            changes[each.name] = value
    if "environment" in changes:  # an option that also sets the shading
        changes["shading"] = view.shading
    # Options unset others, as a side does an eye. Anything else that differs has no option.
    said = own.changed(**changes)
    for name in settings_of(View):
        if getattr(said, name) != getattr(view, name):
            raise ConfigError(f"an option cannot say the view's {name}: copy the Python")
    words = ["clbvh", "render", *sources]
    for name, value in changes.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
        else:
            words += [f"--{option}", _phrase_value(value)]
    return shlex.join([*words, "-o", "picture.png"])


def phrase_python(sources: Sequence[str], view: View) -> str:
    """Return Python that renders a view; where there is no file, it speaks of `scene` and `environment`."""
    values = {name: repr(value) for name, value in plain_view(view).items()}
    if view.camera is not None:
        values["camera"] = _qualify(repr(view.camera))
    if view.environment is not None:
        values["environment"] = repr(view.environment.path) if view.environment.path else "environment"
    settings = ", ".join(f"{name}={value}" for name, value in values.items())
    source = repr(list(sources) if len(sources) > 1 else sources[0]) if sources else "scene"
    return f"view = clbvh.View({settings})\npicture = clbvh.render({source}, view)"


def _get(view: View, setting: Setting) -> Any:
    """Return a setting, also a member of a group, such as ``light_direction``; its default where there is no group."""
    if setting.name in settings_of(View):
        return getattr(view, setting.name)
    group, _, member = setting.name.partition("_")
    return getattr(getattr(view, group), member, setting.default)


def _phrase_value(value: Any) -> str:
    if isinstance(value, tuple):
        return (";" if isinstance(value[0], tuple) else ",").join(map(_phrase_value, value))
    if isinstance(value, Cut):
        return value.text
    if isinstance(value, EnvironmentMap):
        return str(value.path)
    if isinstance(value, Projection):
        return text_of(value)
    return value if isinstance(value, str) else repr(value)


def _qualify(text: str) -> str:
    return re.sub(r"\b(Camera|Lens|Orthographic|Fisheye|Panorama)\(", r"clbvh.\1(", text)
