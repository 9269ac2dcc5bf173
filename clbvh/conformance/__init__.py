"""Stored answers to fixed rays and points, and the check of a device against them."""
