"""Distance and collision of instances: pairs of triangles, found by two trees."""
