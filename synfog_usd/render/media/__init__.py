"""Fog as kernels see it: optical depth, phase functions, and the plane-parallel solution as a control variate."""
