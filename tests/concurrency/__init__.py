"""Several threads at once."""
