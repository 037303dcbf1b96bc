"""Geometry: rotations, splines, linear blend skinning, cameras."""
