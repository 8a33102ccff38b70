"""Camera-conditioned robot policies in JAX. Nothing heavy is imported here."""

__version__ = "0.1.0"
