"""The version of coopmap, in one place: `pyproject.toml` and every report read it from here."""

__version__ = "0.4.0"
