"""Avatars: what is rendered, canonical and posed."""
