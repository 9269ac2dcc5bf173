"""Other people's interfaces, answered by clbvh. Import each one from its own module: none is needed by the core."""
