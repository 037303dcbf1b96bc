"""Training of an avatar and its trajectory against blurred frames."""
