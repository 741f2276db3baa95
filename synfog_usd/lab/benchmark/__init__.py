"""How well others' methods see through fog: pairs of pictures, methods, metrics and tables."""
