"""Settings: frozen records, their presets, their JSON form and their flags; light to import."""

import os

if os.environ.get("NO_COLOR"):  # tyro has a variable of its own, which it reads when it is loaded
    os.environ.setdefault("PYTHON_TYRO_ANSI_CODES", "False")
