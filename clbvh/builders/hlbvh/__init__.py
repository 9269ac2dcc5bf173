"""The build of `quality="fast"`."""
