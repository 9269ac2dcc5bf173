"""clbvh: a parallel BVH build on the host, exact ray casting with OpenCL on any device.

The public names stand in `__init__.pyi`. They are imported when first used, so that `import clbvh` costs nothing and a
build needs no OpenCL driver.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
