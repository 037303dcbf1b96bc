"""Who is in the picture."""
