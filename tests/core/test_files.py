import os
import stat
from itertools import pairwise

import pytest

from coopmap_env.core.files import (
    FileError,
    atomic_path,
    private_folder,
    read_bytes,
    read_json,
    write_atomically,
)
from coopmap_env.core.limits import check_cells
from coopmap_env.core.xml_files import read_xml
from coopmap_env.core.yaml_files import MAX_YAML, MAX_YAML_VALUES, read_yaml_mapping


def test_text_and_bytes_are_written_and_missing_folders_made(tmp_path):
    write_atomically(tmp_path / "new" / "text", "ä")
    write_atomically(tmp_path / "bytes", b"\x00\xff")
    assert (tmp_path / "new" / "text").read_text(encoding="utf-8") == "ä"
    assert (tmp_path / "bytes").read_bytes() == b"\x00\xff"


def test_an_error_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "map.npz"
    path.write_text("old")

    def fail():
        with atomic_path(path) as temporary:
            assert temporary.suffix == ".npz"
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def read_error(read, path, content):
    path.write_bytes(content)
    with pytest.raises(FileError) as error:
        read(path)
    assert str(error.value).startswith(str(path))
    return str(error.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, reason in [
        (tmp_path / "none", "no such file"),
        (tmp_path, "directory"),
        (tmp_path / "pipe", "no regular file"),  # nobody writes to it: waiting would be for ever
        ("/dev/zero", "no regular file"),
        ("a\0b", "null byte"),
    ]:
        with pytest.raises(FileError, match=reason) as error:
            read_bytes(path)
        assert str(path) in str(error.value)


def test_a_file_is_read_up_to_the_limit_that_a_variable_sets(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(b"12345678")
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "8")
    assert read_bytes(path) == b"12345678"
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "7")
    with pytest.raises(FileError, match=r"8 bytes, more than the limit of 7.*COOPMAP_MAX_BYTES"):
        read_bytes(path)


@pytest.mark.parametrize("limit", ["-1", "1e9", "0", "many", "9" * 30])
def test_a_limit_that_is_no_number_is_refused(monkeypatch, limit):
    monkeypatch.setenv("COOPMAP_MAX_CELLS", limit)
    with pytest.raises(ValueError, match="COOPMAP_MAX_CELLS must be an integer"):
        check_cells((2, 2), "a map")


def test_cells_are_counted_without_overflow(monkeypatch):
    check_cells((1 << 13, 1 << 13), "an image")
    with pytest.raises(ValueError, match=r"a map has 125,000,000,000 cells"):
        check_cells((5000, 5000, 5000), "a map")
    with pytest.raises(ValueError, match=r"a map has over 10\*\*15 cells"):
        check_cells((10**400, 2), "a map")
    monkeypatch.setenv("COOPMAP_MAX_CELLS", "200000000000")
    check_cells((5000, 5000, 5000), "a map")


def test_a_yaml_file_that_would_take_minutes_is_refused_at_once(tmp_path):
    message = read_error(read_yaml_mapping, tmp_path / "a.yaml", b"a: [" + b"1," * (1 << 22))
    assert "8,388,612 characters" in message


def test_yaml_of_many_or_nested_values_is_refused_where_they_are_too_many(tmp_path, monkeypatch):
    """What stands behind is not read, and 300 brackets around a value are 300 times its time."""
    monkeypatch.setattr("coopmap_env.core.yaml_files.MAX_YAML_VALUES", 1_000)
    many = "a: 1\nb: [" + "[]," * 300_000 + "]"
    message = read_error(read_yaml_mapping, tmp_path / "a.yaml", many.encode())
    assert "line 2: expected 1,000 values at most" in message
    nested = "a: [" + ("[" * 300 + "]" * 300 + ",") * 2_000 + "]"
    message = read_error(read_yaml_mapping, tmp_path / "a.yaml", nested.encode())
    assert "50 inside of each other" in message


def test_a_yaml_file_of_the_largest_scene_is_read(tmp_path):
    box = "- {box: [1.25, 1.25, 1.25], position: [12.5, 12.5, 0.5], rpy: [0, 0, 30], name: b_%d}\n"
    path = tmp_path / "a.yaml"
    path.write_text("objects:\n" + "".join(box % k for k in range(2_000)))
    assert len(read_yaml_mapping(path)["objects"]) == 2_000
    n_values = 18 * 10_000
    assert n_values < MAX_YAML_VALUES
    assert 5 * len(path.read_text()) < MAX_YAML


def test_yaml_aliases_are_refused_before_they_are_expanded(tmp_path):
    lines = ["a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in pairwise("abcdefghijklm")]
    message = read_error(read_yaml_mapping, tmp_path / "a.yaml", "\n".join(lines).encode())
    assert "line 2" in message
    assert "alias *a" in message


@pytest.mark.parametrize(
    "text",
    ["[" * 5000, "a: 2020-99-99", "a: " + "9" * 5000, "{[1]: 2}", "- 1\n" * 9999, "\xff",
     "a: !!python/object:os.system x", "<<: [1]", "a: !!bool x", "a: !!timestamp x", "a: !!int ''"],
)  # fmt: skip
def test_yaml_that_is_no_mapping_is_refused_in_few_words(tmp_path, text):
    message = read_error(read_yaml_mapping, tmp_path / "a.yaml", text.encode("latin-1"))
    assert len(message) < len(str(tmp_path)) + 700


def test_a_field_of_yaml_that_is_there_twice_is_refused_with_its_line(tmp_path):
    text = b"image: a\nmode: raw\nimage: b\n"
    assert "line 3: 'image' is there twice" in read_error(
        read_yaml_mapping, tmp_path / "a.yaml", text
    )
    nested = b"a: {b: [{c: 1, c: 2}]}"
    assert "'c' is there twice" in read_error(read_yaml_mapping, tmp_path / "a.yaml", nested)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "1" * 5000, "\xff"])
def test_text_that_is_no_json_is_refused(tmp_path, text):
    read_error(read_json, tmp_path / "a.json", text.encode("latin-1"))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<robot>\n <link>\n", "line 3"),
        ("<robot>\n</link>", "line 2"),
        ("<?xml version='1.0' encoding='nope'?><a/>", "unknown encoding"),
        ("<!DOCTYPE r [<!ENTITY a 'b'>]><r>&a;</r>", "document types"),
        ("", "line 1"),
    ],
)
def test_xml_is_parsed_strictly(tmp_path, text, reason):
    assert reason in read_error(read_xml, tmp_path / "a.urdf", text.encode())


def test_xml_may_begin_with_empty_lines(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text("\n\r\n <?xml version='1.0'?>\n<robot/>")
    assert read_xml(path).tag == "robot"
    assert "line 5" in read_error(read_xml, path, b"\n\n\n<?xml version='1.0'?>\n</robot>")


def test_document_types_are_refused_in_every_encoding(tmp_path):
    text = "<!DOCTYPE r [<!ENTITY a 'b'>]><r>&a;</r>"
    for encoding in ("utf-8", "utf-16"):
        assert "document types" in read_error(read_xml, tmp_path / "a.urdf", text.encode(encoding))


def test_the_private_folder_is_made_for_the_user_alone(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = private_folder()
    assert folder.parent == tmp_path
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert private_folder() == folder


@pytest.mark.parametrize("planted", ["link", "file", "open to others"])
def test_a_private_folder_that_somebody_else_could_have_planted_is_refused(
    tmp_path, monkeypatch, planted
):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = private_folder()
    folder.rmdir()
    if planted == "link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "theirs")
    elif planted == "file":
        folder.write_text("")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    with pytest.raises(FileError, match=r"0700.*TMPDIR"):
        private_folder()
