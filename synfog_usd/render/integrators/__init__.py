"""The estimators of light in fog: path tracing, froxels, the atmospheric scattering model, the glow of lamps."""
