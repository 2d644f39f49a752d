"""What all readers of PLY files need: the types by name, and where the header ends."""

import re

PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
"""Types of numpy without their byte order, by the names of PLY."""
_FIRST_LINE = re.compile(rb"ply[ \t]*(\r\n|\n|\r)")


def split_header(content: bytes) -> tuple[list[str], bytes]:
    """Lines of the header, and what follows it.

    Lines end as on Linux, Windows or old Macs. The last one of the header ends as the first one if
    it can: a binary body may begin with the byte of a line end.

    Raises
    ------
    ValueError
        If there is no such header.
    """
    first = _FIRST_LINE.match(content)
    if first is None:
        raise ValueError("this is no PLY file: its first line must be ply")
    line_end = b"(?:" + first[1] + rb"|\r\n|\n|\r)"
    end = re.search(rb"[\r\n]end_header[ \t]*" + line_end, content)
    if end is None:
        raise ValueError("broken PLY file: it has no end_header")
    return content[: end.start()].decode("ascii", "replace").splitlines(), content[end.end() :]
