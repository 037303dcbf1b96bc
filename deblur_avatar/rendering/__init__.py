"""From Gaussians and meshes to pixels."""
