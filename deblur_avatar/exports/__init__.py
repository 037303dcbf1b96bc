"""Exporters: files that other programs open, made from a fitted run."""
