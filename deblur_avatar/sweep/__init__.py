"""Sweeps: the stages of pipelines as tasks on an engine; DVC records what was made from what."""
