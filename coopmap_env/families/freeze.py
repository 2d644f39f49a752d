"""`python -m coopmap_env.families.freeze`: write the hashes of all worlds of families.

Only for a family that is new, or that gets a new version: a frozen world does not change.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log
from coopmap_env.families import FAMILIES, get
from coopmap_env.families.family import Family
from coopmap_env.families.worlds import N_WORLDS, definition_hash, world_hash

FOLDER = Path(__file__).parent / "hashes"


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
    parser.add_argument("names", nargs="*", default=sorted(FAMILIES), help="default: all")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder of the files")
    options = parser.parse_args(arguments)
    for name in options.names:
        text = json.dumps(hashes_of(get(name), N_WORLDS), indent=0) + "\n"
        write_atomically(options.out / f"{name}.json", text)


if __name__ == "__main__":
    main()
