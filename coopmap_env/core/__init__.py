"""The ground: files, serialisation, optional imports, argument checks; each exists once."""
