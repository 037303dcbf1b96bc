"""How unknowns are estimated."""
