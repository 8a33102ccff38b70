"""Whole files of YAML, from anybody: data only, and no name twice."""

from pathlib import Path
from typing import Any

import yaml

from jaxcam.errors import ConfigError
from jaxcam.files.paths import read_text


def read_yaml(path: Path) -> Any:
    """The content of a file of YAML.

    Args:
        path: Of the file.

    Raises:
        ConfigError: There is none that can be read, it is not YAML, or a name is in a mapping
            twice, of which YAML's readers would keep the last.
    """
    try:
        return yaml.load(read_text(path), _Loader)
    except FileNotFoundError as error:
        raise ConfigError(f"{path} cannot be read: no such file.") from error
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {error}.") from error


class _Loader(yaml.SafeLoader):
    """PyYAML's safe one, that refuses a name that is there twice."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """The mapping of a node."""
        names: set[str] = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(key, yaml.ScalarNode):
                if key.value in names:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"{key.value!r:.80} is there twice", key.start_mark
                    )
                names.add(key.value)
        return super().construct_mapping(node, deep)
