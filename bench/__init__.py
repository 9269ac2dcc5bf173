"""Measurements beside the peers; `make bench` runs them. They print, and fail only when something is wrong."""
