"""Evaluation: image metrics, motion errors, held-out blur, recovery."""
