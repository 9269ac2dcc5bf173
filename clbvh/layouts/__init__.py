"""A finished tree as the arrays that a device traverses: one file per layout."""
