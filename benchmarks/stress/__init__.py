"""Stress suite: small scenes with known truth, ways to fail, rules."""
