"""Drift: by how much cameras have moved since their poses were found, episode by episode."""
