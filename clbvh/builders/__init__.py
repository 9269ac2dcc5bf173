"""Shape to tree: each builder in a folder, and the pool of worker processes."""
