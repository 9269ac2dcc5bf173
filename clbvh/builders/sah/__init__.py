"""The default builder: binned surface area heuristic, parallel from the root."""
