"""Strict readers of foreign binary files: pickles, npz, network weights."""
