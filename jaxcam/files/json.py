"""Whole files of JSON, from anybody."""

import json
from pathlib import Path
from typing import Any

from jaxcam.errors import DatasetError
from jaxcam.files.paths import read_text


class _TwiceError(ValueError):
    """A name is in an object twice."""


def read_json(path: Path) -> Any:
    """The content of a file of JSON.

    Args:
        path: Of the file.

    Raises:
        DatasetError: There is none that can be read, it is not JSON, or a name is in an object
            twice, of which JSON's readers would keep the last.
    """
    try:
        return json.loads(read_text(path), object_pairs_hook=_once)
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: no such file.") from error
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.") from error
    except _TwiceError as error:
        raise DatasetError(f"{path}: {error}.") from error
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path} is not JSON: {error}.") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise _TwiceError(f"{twice!r:.80} is there twice")
    return content
