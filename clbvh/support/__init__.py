"""Things that any program needs, none of them about rays."""
