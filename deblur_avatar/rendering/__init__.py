"""Rendering: Gaussians by rasterization, meshes by ray casting."""
