"""XML files, parsed strictly and without document types."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET

from coopmap_env.core.files import FileError, read_bytes


def read_xml(path: str | os.PathLike[str], error_type: type[FileError] = FileError) -> ET.Element:
    """Root of an XML file; see `read_bytes` and `parse_xml`."""
    return parse_xml(read_bytes(path, error_type), str(path), error_type)


def parse_xml(content: bytes, name: str, error_type: type[FileError] = FileError) -> ET.Element:
    """Root of XML, parsed strictly; `name` says in errors where it is from.

    Document types (``<!DOCTYPE``) are refused: their entities can stand for gigabytes.

    Raises
    ------
    error_type
        If it is not XML, with the line and column.
    """

    class BuilderWithoutDoctype(ET.TreeBuilder):
        def doctype(self, *declaration: str | None) -> None:
            raise error_type(f"{name}: document types (<!DOCTYPE, <!ENTITY) cannot be read")

    start = content.lstrip(b" \t\r\n")  # robot models begin with empty lines at times
    try:
        return ET.fromstring(start, ET.XMLParser(target=BuilderWithoutDoctype()))
    except error_type:
        raise
    except (ET.ParseError, ValueError, LookupError) as error:  # LookupError: unknown encoding
        line, column = getattr(error, "position", (1, 0))
        line += content[: len(content) - len(start)].count(b"\n")
        raise error_type(f"{name}, line {line}, column {column}: expected XML: {error}") from error
