"""Compiles ahead all that the commands and the public functions need, so that nobody waits in a first run."""
