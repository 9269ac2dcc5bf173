"""Image files, one module per format: arrays of pixels in, bytes out, or the other way. None of it knows of scenes."""
