"""What paths carry: R, G and B, or wavelength bands; surfaces with spectra of their own."""
