"""A real robot: where its cameras are."""
