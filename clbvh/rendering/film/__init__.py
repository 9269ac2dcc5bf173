"""Pictures from many samples a pixel: how surfaces look on the device, and films that add up light."""
