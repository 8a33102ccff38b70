"""MJX's records are made at run time, which hides their fields and kinds from a type checker."""

from typing import Any

def __getattr__(name: str) -> Any: ...
