"""The version of the package, from where the build reads it: to ask the installation for it takes 25 ms."""

__version__ = "0.2.0"
