"""Datasets in LeRobot's format, read: what is where, numbers in tables, pictures in files."""
