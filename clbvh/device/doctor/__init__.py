"""Causes of missing or failing OpenCL devices, and remedies: the checks behind `clbvh doctor`."""
