"""The version of the installed package, from its metadata; reading that takes milliseconds, so it is read once."""

from importlib.metadata import PackageNotFoundError, version

# A folder on the path that was never installed has no metadata.
UNKNOWN = "0+unknown"

try:
    __version__ = version("clbvh")
except PackageNotFoundError:
    __version__ = UNKNOWN
