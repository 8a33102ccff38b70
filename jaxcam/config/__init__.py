"""Settings: frozen records, their presets, their JSON form and their flags; light to import."""
