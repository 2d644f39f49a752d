"""Where the meshes are that a URDF names."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from coopmap_env.core.files import FileError, brief
from coopmap_env.core.xml_files import read_xml
from coopmap_env.robots.kinematics.urdf_xml import UrdfError, UrdfNotFoundError


def resolve_mesh(filename: str, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> Path:
    """Path of a mesh that a URDF names.

    A relative path starts at the URDF's folder or at one of `package_dirs`, and
    ``package://name/path`` there as well, with and without the name. Above the URDF and in
    `package_dirs`, the package is also a folder of its name, or one with a package.xml of its name.

    Raises
    ------
    UrdfNotFoundError
        Naming the folders searched.
    UrdfError
        If the name is an address of another kind.
    """
    scheme, separator, rest = filename.partition("://")
    if separator and scheme not in ("file", "package"):
        raise UrdfError(
            f"{urdf} names the mesh {brief(filename)}: expected a path, file:// or package://"
        )
    folders = [urdf.parent, *map(Path, package_dirs)]
    relative_path = rest if separator else filename
    candidates = [folder / relative_path for folder in folders]
    if scheme == "package" and separator:
        name, _, inside = relative_path.partition("/")
        candidates += [folder / inside for folder in folders]
        candidates += [folder / inside for folder in _package_folders(name, urdf, folders)]
    for candidate in candidates:
        if os.path.isfile(candidate):  # unlike `Path.is_file`, no error for an impossible name
            return candidate
    raise UrdfNotFoundError(
        f"{urdf} names the mesh {filename:.300}, which is in none of {[str(f) for f in folders]}"
        f"{', nor in a package of this name above them' if scheme == 'package' else ''}; "
        f"give the folder that holds it as package_dirs"
    )


def _package_folders(name: str, urdf: Path, folders: Sequence[Path]) -> Iterator[Path]:
    """Folders that may be a package: above the URDF and the `folders`, and below those by name."""
    for start in dict.fromkeys([Path(os.path.abspath(urdf)).parent, *map(Path.absolute, folders)]):
        for folder in (start, *start.parents):
            if folder.name == name or _package_name(folder) == name:
                yield folder
            yield folder / name


def _package_name(folder: Path) -> str | None:
    """The name in a folder's package.xml, if it has one."""
    file = folder / "package.xml"
    if not os.path.isfile(file):
        return None
    try:
        return (read_xml(file).findtext("name") or "").strip()
    except FileError:  # of another use of the name: this folder is no package
        return None
