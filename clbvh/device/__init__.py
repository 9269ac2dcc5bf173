"""The host and the devices of OpenCL behind one session: choice, kernels, settings, doctor."""
