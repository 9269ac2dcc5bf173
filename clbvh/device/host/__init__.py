"""The host as a device: kernels that were compiled ahead of time, called as functions."""
