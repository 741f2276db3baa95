"""Sets as other people's loaders want them: one module for each format, one record (`record.py`) that describes it."""
