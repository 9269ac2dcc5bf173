"""The content of a scene: geometries and their instances. Knows nothing of trees, devices and pictures."""
