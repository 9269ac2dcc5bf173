"""Files of scenes and of pictures."""
