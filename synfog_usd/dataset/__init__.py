"""Many shots: what to make, making it, labels, and a sheet to look at."""
