"""What every room stands on: errors, seeds, images, spectra, files that appear whole, the fence round a stage."""
