"""Parametric bodies: Anny, SMPL, capsules; posed by linear blend skinning."""
