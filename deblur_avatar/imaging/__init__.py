"""How light becomes pixels."""
