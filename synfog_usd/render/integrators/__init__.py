"""The estimators of light in fog: path tracing, light of lamps on the camera's segment, and Mitsuba's own as peers."""
