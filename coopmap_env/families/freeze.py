"""The hashes of all worlds of families.

::

    python -m coopmap_env.families.freeze coopmap_env/families/hashes NAME

Only for a family that is new, or that gets a new version: a frozen world does not change.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from coopmap_env.core.files import read_json, write_atomically
from coopmap_env.core.progress import log
from coopmap_env.families import FAMILIES, get
from coopmap_env.families.family import Family
from coopmap_env.families.worlds import COLUMNS, DEFINITIONS, N_WORLDS, definition_hash, world_hash


def hashes_of(family: Family, n_worlds: dict[str, int]) -> dict[str, Any]:
    """Hashes of the first worlds of each split; see `worlds.frozen_hashes`."""
    hashes: dict[str, Any] = {"definition": definition_hash(family)}
    for split, n in n_worlds.items():
        env, found = family.make(split), []
        for seed in range(n):
            env.reset(seed=seed)
            found.append(world_hash(env))
        env.close()
        hashes[split] = found
        log(f"{family.name}: {n} worlds of {split}")
    return hashes


def main(arguments: list[str] | None = None) -> None:
    """Write a file for each family that is named."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.families.freeze", description="Hash the worlds of families."
    )
    parser.add_argument("folder", type=Path, help="of the files, one for each family")
    parser.add_argument("names", nargs="*", default=sorted(FAMILIES), help="default: all")
    options = parser.parse_args(arguments)
    path = options.folder / DEFINITIONS
    definitions = read_json(path) if path.exists() else {}
    for name in options.names:
        hashes = hashes_of(get(name), N_WORLDS)
        definitions[name] = hashes["definition"]
        rows = [(split, seed, own) for split in N_WORLDS for seed, own in enumerate(hashes[split])]
        text = "".join(f"{','.join(map(str, row))}\n" for row in [COLUMNS, *rows])
        write_atomically(options.folder / f"{name}.csv", text)
        write_atomically(options.folder / DEFINITIONS, json.dumps(definitions, indent=1) + "\n")


if __name__ == "__main__":
    main()
