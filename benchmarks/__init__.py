"""Benchmarks: speed and accuracy; each module prints a table and writes JSON."""
