"""The page of a study: its parts, the figures, and the HTML."""
