"""Settings as fields of dataclasses: each has a default, a kind that checks its values, and one line of help.

The keywords of Python, scene files, the command line and the reference page are made from these fields. Imports no
numpy: `clbvh render --help` reads this.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, TypeVar

from ..errors import ClbvhError, SceneError

_MAX_SHOWN = 80  # characters of a wrong value in a message

_Settings = TypeVar("_Settings")


@dataclass(frozen=True)
class Kind:
    """The values that a setting takes.

    Attributes
    ----------
    text : str
        As messages and pages say it, behind "must be".
    read : function
        Returns the value that is kept; raises `ValueError` or `TypeError` for another one, or an error of clbvh with a
        sentence of its own.
    option : type
        Of the command line's option: int, float, bool or str.
    metavar : str
        As the command line's help shows a value; empty: by `option`.
    members : type, or None
        The dataclass of a group, whose members are settings, too.
    takes_arrays : bool
        Whether `read` gets arrays of numpy as they are, which may be large; otherwise they become tuples.
    """

    text: str
    read: Callable[[Any], Any]
    option: type = str
    metavar: str = ""
    members: type | None = None
    takes_arrays: bool = False

    def take(self, name: str, value: Any, or_none: str = "", error: type[ClbvhError] = SceneError) -> Any:
        """Return the value that is kept; raise an error that begins with the name for any other one."""
        try:
            return self.read(value if self.takes_arrays else _as_python(value))
        except ClbvhError as reason:
            if isinstance(value, Mapping):  # the settings of a group
                raise error(f"{name}: {reason}") from None
            raise
        except (TypeError, ValueError, OverflowError):
            raise error(f"{name} must be {self.text}{or_none}, not {_show(value)}") from None


@dataclass(frozen=True)
class Setting:
    """One setting of a dataclass, or of a group in it.

    Attributes
    ----------
    name : str
        As a keyword: ``exposure``, ``light_direction``.
    default : object
    help : str
        One line.
    kind : Kind
    panel : str
        The heading below which pages and help list it.
    shown : str
        The default in words, where the value does not say it.
    is_option : bool
        Whether the command line has it.
    """

    name: str
    default: Any
    help: str
    kind: Kind
    panel: str
    shown: str
    is_option: bool

    def read(self, value: Any, prefix: str = "", error: type[ClbvhError] = SceneError) -> Any:
        """Return the value that is kept; raise an error for one that the setting does not take.

        Parameters
        ----------
        prefix : str
            Of the name in the message: that of a group, with an underscore.
        error : type
        """
        if value is False and self.kind.members is not None:
            value = None
        if value is None and self.default is None:
            return None
        return self.kind.take(prefix + self.name, value, ", or None" if self.default is None else "", error)


def setting(default: Any, help: str, kind: Kind, panel: str = "", *, shown: str = "", is_option: bool = True) -> Any:
    """Return a field of a dataclass with settings, see `Setting`; a default of None allows None."""
    return dataclasses.field(
        default=default, metadata={"help": help, "kind": kind, "panel": panel, "shown": shown, "is_option": is_option}
    )


_known: dict[type, dict[str, Setting]] = {}


def settings_of(owner: type) -> dict[str, Setting]:
    """Return the settings of a dataclass by their names."""
    if owner not in _known:
        fields = (each for each in dataclasses.fields(owner) if "kind" in each.metadata)
        _known[owner] = {each.name: Setting(each.name, each.default, **each.metadata) for each in fields}
    return _known[owner]


def list_settings(owner: type) -> tuple[Setting, ...]:
    """Return the settings of a dataclass, each group followed by its members, such as ``light_direction``."""
    listed: list[Setting] = []
    for group in settings_of(owner).values():
        listed.append(group)
        if group.kind.members is not None:
            listed += [
                dataclasses.replace(member, name=f"{group.name}_{member.name}", panel=group.panel)
                for member in settings_of(group.kind.members).values()
            ]
    return tuple(listed)


def check_settings(owner: Any, prefix: str = "", error: type[ClbvhError] = SceneError) -> None:
    """Replace the values of a frozen dataclass by those that are kept; raise an error for a wrong one.

    Parameters
    ----------
    prefix, error
        See `Setting.read`.
    """
    for name, each in settings_of(type(owner)).items():
        value = getattr(owner, name)
        if value is not each.default:
            object.__setattr__(owner, name, each.read(value, prefix, error))


def change_settings(
    owner: _Settings, changes: Mapping[str, Any], error: type[ClbvhError] = SceneError
) -> _Settings:  # fmt: skip
    """Return a dataclass with other settings; members of a group change that group.

    Raises
    ------
    SceneError, or another error
        There is no setting of a name, or a value is wrong.
    """
    known = settings_of(type(owner))
    direct = {name: value for name, value in changes.items() if name in known}
    # In the order in which they were given, so that of several wrong names the first is said.
    for name in [name for name in changes if name not in known]:
        group = next((each for each in known.values() if _is_member(name, each)), None)
        if group is None:
            raise error(say_unknown(name, [each.name for each in list_settings(type(owner))]))
        value = direct.get(group.name, getattr(owner, group.name))
        current = group.kind.read(True if value is None or value is False else value)
        direct[group.name] = change_settings(current, {name[len(group.name) + 1 :]: changes[name]})
    return dataclasses.replace(owner, **direct)  # type: ignore[type-var]


def say_unknown(name: str, known: Iterable[str], what: str = "setting") -> str:
    """Return the sentence about a name that does not exist, with the nearest one that does."""
    known = list(known)
    close = difflib.get_close_matches(name, known, 1)
    rest = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(known) or 'none'}"
    return f"there is no {what} '{name[:_MAX_SHOWN]}': {rest}"


def as_plain(owner: Any) -> dict[str, Any]:
    """Return the settings that differ from their defaults, as JSON takes them; groups are tables."""
    plain = {}
    for name, each in settings_of(type(owner)).items():
        value = getattr(owner, name)
        if value != each.default:
            plain[name] = as_plain(value) if each.kind.members is not None else value
    return plain


def only(is_right: Callable[[Any], bool]) -> Callable[[Any], Any]:
    """Return the function that returns values as they are, and raises `ValueError` for one that is not right."""

    def read(value: Any) -> Any:
        if not is_right(value):
            raise ValueError
        return value

    return read


def whole(least: int, most: int) -> Kind:
    """Return whole numbers from `least` to `most`."""
    read = only(lambda value: isinstance(value, int) and not isinstance(value, bool) and least <= value <= most)
    return Kind(f"a whole number from {least:,} to {most:,}", read, int)


def number(
    least: float | None = None, most: float | None = None, *, above: float | None = None, below: float | None = None
) -> Kind:
    """Return finite numbers with these limits."""
    limits = (("from", least), ("above", above), ("up to", most), ("below", below))
    text = " and ".join(f"{word} {limit:,.15g}" for word, limit in limits if limit is not None)
    if least is not None:
        text = text.replace(" and up to", " to")

    def read(value: Any) -> float:
        value = _read_number(value)
        is_inside = (least is None or value >= least) and (most is None or value <= most)
        if not (is_inside and (above is None or value > above) and (below is None or value < below)):
            raise ValueError
        return value

    return Kind(f"a number {text}" if text else "a finite number", read, float)


def one_of(names: Iterable[str]) -> Kind:
    """Return names."""
    names = tuple(names)
    return Kind(f"one of {', '.join(names)}", only(lambda value: value in names), metavar="|".join(names))


def flag() -> Kind:
    """Return True and False."""
    return Kind("True or False", only(lambda value: isinstance(value, bool)), bool)


def vector(least: float | None = None, most: float | None = None, *, metavar: str = "X,Y,Z") -> Kind:
    """Return three finite numbers within limits, also as a text with commas."""
    part = number(least, most)
    limits = part.text.removeprefix("a number") if least is not None or most is not None else ""

    def read(value: Any) -> Vector:
        x, y, z = map(part.read, _split(value))
        return x, y, z

    return Kind(f"three finite numbers{limits}", read, metavar=metavar)


def group(members: type[Any], text: str) -> Kind:
    """Return a dataclass of settings, also as a table of them; True for its defaults, and False for None."""

    def read(value: Any) -> Any:
        if value is True:
            return members()
        if isinstance(value, Mapping):
            return change_settings(members(), value)
        if not isinstance(value, members):
            raise TypeError
        return value

    return Kind(text, read, bool, members=members)


Vector = tuple[float, float, float]
"""Three numbers: a point, a direction, or a linear colour."""


def _is_member(name: str, group: Setting) -> bool:
    members = group.kind.members
    return members is not None and name.removeprefix(f"{group.name}_") in settings_of(members) and name != group.name


def _split(value: Any) -> Iterable[Any]:
    return map(float, value.split(",")) if isinstance(value, str) else value


def _read_number(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError
    return float(value)


def _as_python(value: Any) -> Any:
    """Return a value with Python's own numbers and tuples, at every depth, in place of numpy's and of lists."""
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        parts = value.tolist() if hasattr(value, "tolist") else value
        return tuple(map(_as_python, parts)) if isinstance(parts, list | tuple) else parts
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)


def _show(value: Any) -> str:
    """Return the beginning of a wrong value."""
    try:
        return " ".join(repr(value).split())[:_MAX_SHOWN]
    except ValueError:  # Python does not print integers of many thousand digits
        return "a number of many digits"
