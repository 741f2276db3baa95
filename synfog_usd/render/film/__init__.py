"""What is kept of the samples: sums and their moments by pixel, and AOVs that need no samples."""
