"""Studio: a synthetic clothed person, filmed from all sides, with exact ground truth."""
