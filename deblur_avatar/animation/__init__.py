"""Animation: motion files, retargeting, placement."""
