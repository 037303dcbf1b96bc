"""Image formation: light, exposure, interpolation, resampling, matting, files."""
