"""How fast and how accurate: each module prints a table and writes JSON."""
