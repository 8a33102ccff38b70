"""Keys of policy servers, in files: so that others on the machine do not see them."""

from pathlib import Path

from jaxcam.client import is_key
from jaxcam.errors import ConfigError
from jaxcam.files.paths import read_text


def read_key(file: Path, what: str) -> str:
    """The key in a file: its first line.

    Args:
        file: The file.
        what: Who names it, for messages.

    Raises:
        ConfigError: It cannot be read or is empty, or the line is no key.
    """
    try:
        key = (read_text(file).splitlines() or [""])[0].strip()
    except (OSError, ValueError) as error:
        raise ConfigError(f"{what} {file} cannot be read: {error}.") from error
    if not key:
        raise ConfigError(f"{what} {file} is empty; its first line is the key.")
    check_key(key, f"{what} {file}: its first line is no key.")
    return key


def check_key(key: str, where: str = "") -> None:
    """Refuse what cannot be sent as a key.

    Args:
        key: What is meant to be one.
        where: Whose it is, for the message.

    Raises:
        ConfigError: It is none.
    """
    if not is_key(key):
        words = "A key is one word of ASCII letters, digits and signs."
        raise ConfigError(f"{where} {words}".strip())
