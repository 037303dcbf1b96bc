"""A synthetic clothed person, filmed from all sides, with exact truth."""
