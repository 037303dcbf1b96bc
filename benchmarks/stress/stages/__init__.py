"""Stages of the stress suite."""
