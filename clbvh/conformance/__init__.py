"""Every OpenCL runtime gives the same answers: a fixed set of meshes, rays and points, and what was stored of them."""
