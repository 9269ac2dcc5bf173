"""The build of `quality="fast"`, on an OpenCL device: clusters along a curve merge with their nearest neighbours."""
