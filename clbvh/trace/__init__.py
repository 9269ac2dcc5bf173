"""Rays in, hits out."""
