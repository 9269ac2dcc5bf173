"""A mesh becomes a tree on the host, by worker processes or in the calling process."""
