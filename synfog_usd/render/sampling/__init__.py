"""Random numbers of paths, and resampling."""
