"""Threads, atomic files, the cache folder, free memory: nothing that knows of rays."""
