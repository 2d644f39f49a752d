"""Metadata of the frozen worlds, for catalogues of datasets.

::

    python -m coopmap_env.families.croissant coopmap_env/families/croissant.json

Croissant (https://docs.mlcommons.org/croissant) describes a dataset as JSON-LD, which its library
`mlcroissant` checks and loads. The dataset are the hashes of worlds: worlds themselves are made
from their seeds. The file is written again whenever hashes change; a test compares it with what
this writes.
"""

from __future__ import annotations

import argparse
import json
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any

import mlcroissant as mlc

from coopmap_env.core.files import write_atomically
from coopmap_env.families import FAMILIES
from coopmap_env.families.family import Family

VERSION = "1.0.0"
"""Of the frozen worlds."""
PUBLISHED = "2026-12-01"
DESCRIPTION = (
    "Worlds of the benchmark families of coopmap, for cooperative active mapping: a team of robots "
    "with cameras maps an unknown world. A world is made from its family, split and seed by "
    "coopmap_env.families.make(family, split).reset(seed=seed). Its hash has the first 16 "
    "hexadecimal digits of a SHA-256; coopmap_env.families.check_world compares it. The worlds are "
    "synthetic: no person, place or recording is in them."
)
FIELDS = {
    "split": ("train, validation or test", mlc.DataType.TEXT),
    "seed": ("seed of the reset, from 0 on in each split", mlc.DataType.INTEGER),
    "world_hash": ("hash of the world and of where its team starts", mlc.DataType.TEXT),
}


def metadata() -> dict[str, Any]:
    """The metadata of all families, as JSON values."""
    dataset = mlc.Metadata(
        name="coopmap-worlds",
        description=DESCRIPTION,
        cite_as="See CITATION.cff of coopmap.",
        license=["https://opensource.org/license/mit"],
        version=VERSION,
        date_published=PUBLISHED,
        creators=[mlc.Organization(name="The coopmap founders")],
        distribution=[_file(name) for name in FAMILIES],
        record_sets=[_record_set(family) for family in FAMILIES.values()],
    )
    values: dict[str, Any] = json.loads(json.dumps(dataset.to_json(), default=str))
    return values


def _file(family: str) -> mlc.FileObject:
    name = f"{family}.csv"
    content = (resources.files("coopmap_env.families") / "hashes" / name).read_bytes()
    return mlc.FileObject(
        id=name,
        name=name,
        description=f"hashes of the worlds of the family {family}",
        content_url=f"hashes/{name}",
        encoding_formats=["text/csv"],
        sha256=sha256(content).hexdigest(),
    )


def _record_set(family: Family) -> mlc.RecordSet:
    return mlc.RecordSet(
        id=family.name,
        name=family.name,
        description=family.summary,
        fields=[
            mlc.Field(
                id=f"{family.name}/{column}",
                name=column,
                description=description,
                data_types=[data_type],
                source=mlc.Source(
                    file_object=f"{family.name}.csv", extract=mlc.Extract(column=column)
                ),
            )
            for column, (description, data_type) in FIELDS.items()
        ],
    )


def text() -> str:
    """The text of the file."""
    return json.dumps(metadata(), indent=1) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.families.croissant", description="Describe the frozen worlds."
    )
    parser.add_argument("file", type=Path, help="beside the folder hashes")
    write_atomically(parser.parse_args(arguments).file, text())


if __name__ == "__main__":
    main()
