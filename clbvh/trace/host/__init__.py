"""Rays that the host casts itself, at the arrays of the device's tree."""
