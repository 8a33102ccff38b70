"""The terminal: how commands start, how errors and progress are shown."""
