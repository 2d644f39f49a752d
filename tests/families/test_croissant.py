"""Croissant metadata of the frozen worlds."""

import shutil
from pathlib import Path

import pytest

from coopmap_env import families
from coopmap_env.families.worlds import COLUMNS, frozen_hashes

FOLDER = Path(__file__).parents[2] / "coopmap_env" / "families"
FILE = FOLDER / "croissant.json"

mlcroissant = pytest.importorskip("mlcroissant")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib")


def test_the_file_is_what_the_command_writes(tmp_path):
    from coopmap_env.families import croissant

    croissant.main([str(tmp_path / "croissant.json")])
    written = (tmp_path / "croissant.json").read_text()
    assert written == FILE.read_text(), "as coopmap_env.families.croissant writes it"


def test_the_library_finds_no_fault():
    issues = mlcroissant.Dataset(jsonld=str(FILE)).metadata.issues
    assert not issues.errors
    assert not issues.warnings


@pytest.mark.parametrize("name", families.FAMILIES)
def test_records_are_the_hashes_of_all_seeds(name):
    found = {split: {} for split in families.N_WORLDS}
    for record in mlcroissant.Dataset(jsonld=str(FILE)).records(name):
        split, seed, own = (record[f"{name}/{column}"] for column in COLUMNS)
        found[split.decode()][seed] = own.decode()
    for split, hashes in found.items():
        assert hashes == dict(enumerate(frozen_hashes(name)[split]))


def test_changed_hashes_are_noticed(tmp_path):
    shutil.copy(FILE, tmp_path)
    shutil.copytree(FOLDER / "hashes", tmp_path / "hashes")
    path = tmp_path / "hashes" / "narrow.csv"
    path.write_text(path.read_text().replace("a", "b", 1))
    records = mlcroissant.Dataset(jsonld=str(tmp_path / "croissant.json")).records("narrow")
    with pytest.raises(mlcroissant.GenerationError) as error:
        list(records)
    assert "hash" in str(error.value.__cause__).lower()
