"""The options of a rendering that do not change the picture. The command line derives its options from them.

So it can be imported without numpy: layouts are imported when a choice is checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..builders.tree_options import TreeOptions
from ..support.settings import Kind, flag, setting

if TYPE_CHECKING:
    from ..device.info import DeviceInfo


def _read_layout(layout: str) -> str:
    from ..trace.world.trees import check_layout

    check_layout(layout)
    return layout


@dataclass(frozen=True)
class RenderOptions(TreeOptions):
    """The options of a rendering that do not change the picture.

    Attributes
    ----------
    builder, workers, build, cache
        See `TreeOptions`.
    device : DeviceInfo, str, int or None
        A number, a part of a name, ``"gpu"`` or ``"host"``, see `Tracer`. By default a GPU, if there is one.
    layout : str
        Layout of the tree on the device: ``"bvh2"``, ``"bvh4"``, ``"bvh8"``, ``"bvh8c"``, which takes half the memory,
        or ``"auto"``: the one that suits the device and the size of the scene, but ``"bvh2"`` for the builder
        ``"frontier"``, because a wide layout would split its large leaves.
    validate : bool
        Check the tree, and compare a sample of the pixels with the slow reference.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.RenderOptions(layout="bvh4").layout
    'bvh4'
    """

    device: DeviceInfo | str | int | None = setting(
        None, "A number, a part of a name, gpu or host; see `clbvh devices`.", Kind("a device", lambda device: device),
        shown="a GPU, if there is one",
    )  # fmt: skip
    layout: str = setting(
        "auto", "Layout of the tree on the device: bvh2, bvh4, bvh8, bvh8c, or auto.", Kind("a layout", _read_layout)
    )
    validate: bool = setting(False, "Check the tree, and compare a sample of pixels with a slow reference.", flag())

    @staticmethod
    def _list_builders() -> tuple[str, ...]:
        """Return the names of all builders, and that of none."""
        from ..trace.world.trees import BRUTE

        return (*TreeOptions._list_builders(), BRUTE)

    @property
    def chosen_layout(self) -> str:
        """The layout to ask the device for, with ``"auto"`` resolved where the builder decides."""
        return "bvh2" if self.layout == "auto" and self.builder == "frontier" else self.layout
