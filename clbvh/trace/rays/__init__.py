"""Rays on their way to the device: read, ordered, packed."""
