"""Worker processes and the memory they share; no geometry."""
