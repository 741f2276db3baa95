"""Fog as kernels see it: optical depth and phase functions."""
