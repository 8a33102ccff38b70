"""Camera-conditioned robot policies in JAX. Nothing heavy is imported here."""

from jaxcam.interrupts import end_commands_at_once

__version__ = "0.2.0"

end_commands_at_once()
