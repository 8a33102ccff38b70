"""pyarrow, an optional extra: what reads and writes LeRobot's tables."""

from jaxcam.errors import ConfigError

try:
    import pyarrow as pa
    from pyarrow import compute, parquet
except ModuleNotFoundError as error:
    raise ConfigError("This needs pyarrow: pip install 'jaxcam[lerobot]'.") from error

__all__ = ["compute", "pa", "parquet"]
