"""Settings as texts, numbers, lists and dicts, as JSON has them, and back."""

from __future__ import annotations

import dataclasses
from numbers import Integral, Real
from typing import Any


def as_plain(value: Any) -> Any:
    """Return a setting without Python's own types: a dataclass as a dict, an array or a tuple as a list."""
    if dataclasses.is_dataclass(value):
        return {each.name: as_plain(getattr(value, each.name)) for each in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {name: as_plain(item) for name, item in value.items()}
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    return [as_plain(item) for item in value]


def as_setting(value: Any) -> Any:
    """Return a value of JSON as settings have it: lists are tuples, at every depth."""
    if isinstance(value, dict):
        return {name: as_setting(item) for name, item in value.items()}
    return tuple(map(as_setting, value)) if isinstance(value, list) else value
