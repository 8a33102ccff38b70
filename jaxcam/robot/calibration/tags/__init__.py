"""Tags at known places: where cameras stand, by picture or by episode."""
