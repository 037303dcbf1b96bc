"""Sources of footage: the studio, data sets, calibrated cameras, one's own video."""
