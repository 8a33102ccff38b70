"""The options of environments that are as small and short as they can be."""

SMALL = {"resolution": 16, "render_size": "20x24", "horizon": 6, "engine": "native"}
