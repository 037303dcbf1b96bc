"""Trajectories: how the body moves while the shutter is open."""
