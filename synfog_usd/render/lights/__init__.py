"""Lights as kernels see them: which to ask, where to aim at, and a lamp with a table of its light."""
