"""Results are found again by the content of all files that decide them."""

import numpy as np
import pytest

from coopmap_env.core.files import FileError
from coopmap_env.evaluation import file_hashes

pytest.importorskip("yaml")
image_module = pytest.importorskip("PIL.Image")


def write_map(folder, image, wall):
    """A planar scene whose YAML file names an image; a row of it is a wall."""
    pixels = np.full((20, 30), 254, np.uint8)
    pixels[wall] = 0
    (folder / image).parent.mkdir(parents=True, exist_ok=True)
    image_module.fromarray(pixels).save(folder / image)
    path = folder / "map.yaml"
    path.write_text(
        f"image: {image}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


@pytest.mark.parametrize("image", ["map.png", "MAP.PNG", "maps/map.png", "map.bmp", "map.tif"])
def test_another_image_of_a_planar_scene_is_another_hash(image, tmp_path):
    path = write_map(tmp_path, image, wall=3)
    before = file_hashes("random", str(path), "planar")
    assert set(before) == {str(path), str(tmp_path / image)}
    write_map(tmp_path, image, wall=4)
    assert file_hashes("random", str(path), "planar") != before


def test_images_that_a_scene_does_not_name_do_not_count(tmp_path):
    path = write_map(tmp_path, "map.png", wall=3)
    before = file_hashes("random", str(path), "planar")
    (tmp_path / "photo.png").write_bytes(b"another")
    assert file_hashes("random", str(path), "planar") == before


def test_a_suffix_in_capitals_is_a_scene_file_too(tmp_path):
    path = write_map(tmp_path, "map.png", wall=3).rename(tmp_path / "map.YAML")
    assert str(path) in file_hashes("random", str(path), "planar")


def test_files_of_a_policy_count_and_other_words_do_not(tmp_path):
    (tmp_path / "policy.safetensors").write_bytes(b"abc")
    hashes = file_hashes(f"learned:model={tmp_path / 'policy.safetensors'}+seed=1", "", "planar")
    assert hashes == {
        str(tmp_path / "policy.safetensors"): (
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        )
    }
    for word in ("x" * 5000, "a\0b", str(tmp_path), "nothing"):
        assert file_hashes(f"learned:model={word}", word, "field") == {}


def test_a_scene_file_that_is_no_yaml_is_refused_by_name(tmp_path):
    (tmp_path / "map.yaml").write_text("image: [")
    with pytest.raises(FileError, match=rf"^{tmp_path}/map\.yaml: expected YAML"):
        file_hashes("random", str(tmp_path / "map.yaml"), "planar")


def test_a_file_over_the_limit_is_refused_by_name(tmp_path, monkeypatch):
    (tmp_path / "policy.safetensors").write_bytes(bytes(2000))
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "1000")
    with pytest.raises(FileError, match=r"policy\.safetensors: the file has 2,000 bytes"):
        file_hashes(f"learned:model={tmp_path / 'policy.safetensors'}", "", "planar")
