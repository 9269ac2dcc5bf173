"""Rays in arrays on a device that the device packs itself, also where the host would do it, as on CPUs."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from clbvh.trace import put_rays


@contextmanager
def device_packs() -> Iterator[None]:
    """Let kernels pack such rays in the block; around threads, not in them, since what one undoes is for all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(put_rays, "host_packs", lambda info: False)
        yield
