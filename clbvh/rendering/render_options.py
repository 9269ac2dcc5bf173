"""The options of a rendering that do not change the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..builders.registry import BUILDERS
from ..builders.tree_maker import TreeOptions
from ..device.info import DeviceInfo
from ..trace.device_tree import BRUTE, check_layout


@dataclass(frozen=True)
class RenderOptions(TreeOptions):
    """The options of a rendering that do not change the picture.

    Attributes
    ----------
    builder, workers, build, cache
        See `TreeOptions`. The builder may also be ``"brute"``: no tree.
    device : DeviceInfo, str, int or None
        See `choose_device`.
    layout : str
        Layout of the tree on the device, or ``"auto"``: the one that suits the device, but ``"bvh2"`` for the builder
        ``"frontier"``, because a wide layout would split its large leaves.
    validate : bool
        Check the tree, and compare a sample of the pixels with the slow reference.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.RenderOptions(layout="bvh4").layout
    'bvh4'
    """

    device: DeviceInfo | str | int | None = None
    layout: str = "auto"
    validate: bool = False

    allowed_builders: ClassVar[tuple[str, ...]] = (*BUILDERS, BRUTE)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_layout(self.layout)

    @property
    def chosen_layout(self) -> str:
        """The layout to ask the device for, with ``"auto"`` resolved where the builder decides."""
        return "bvh2" if self.layout == "auto" and self.builder == "frontier" else self.layout
