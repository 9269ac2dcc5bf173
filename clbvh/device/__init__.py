"""Where code runs: the host and the devices of OpenCL, which there are, how to open one, how to compile for it."""
