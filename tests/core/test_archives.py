"""Members of ZIP archives: any compression, no more than what the limits allow, one error."""

import io
import struct
import zipfile

import numpy as np
import pytest
from plain.memory import memory_below

from coopmap_env.core.archives import read_zip_members
from coopmap_env.core.files import FileError

TEXT = b"0 1 2 3 4 5 6 7 8 9\n" * 2000
METHODS = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA]


def archive(compression, *contents):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as file:
        for number, content in enumerate(contents):
            file.writestr(f"member{number}", content)
    return buffer.getvalue()


def with_stated_size(content, size):
    """The archive with another unpacked size of its first member, in both of its headers."""
    at, entry = content.index(b"PK\x03\x04"), content.index(b"PK\x01\x02")
    changed = bytearray(content)
    changed[at + 22 : at + 26] = changed[entry + 24 : entry + 28] = struct.pack("<I", size)
    return bytes(changed)


@pytest.mark.parametrize("compression", METHODS)
def test_members_of_every_compression_are_read(tmp_path, compression):
    path = tmp_path / "some.zip"
    path.write_bytes(archive(compression, TEXT, b"", b"not asked for"))
    assert read_zip_members(path, ["member1", "member0"]) == {"member1": b"", "member0": TEXT}


def test_sizes_together_are_checked_before_anything_is_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "some.zip"
    path.write_bytes(archive(zipfile.ZIP_DEFLATED, bytes(5_000_000), bytes(6_000_000)))
    assert path.stat().st_size < 20_000
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "10000000")
    too_large = r"some\.zip: .*11,000,000 bytes.* COOPMAP_MAX_BYTES"
    with memory_below(1e6), pytest.raises(FileError, match=too_large):
        read_zip_members(path, ["member0", "member1"])
    assert len(read_zip_members(path, ["member1"])["member1"]) == 6_000_000


@pytest.mark.parametrize("compression", METHODS[1:])
def test_no_more_is_unpacked_than_the_archive_states(tmp_path, compression):
    path = tmp_path / "lies.zip"
    path.write_bytes(with_stated_size(archive(compression, bytes(110_000_000)), 1000))
    with memory_below(90e6), pytest.raises(FileError, match=r"lies\.zip: "):
        read_zip_members(path, ["member0"])


def test_less_than_stated_is_an_error(tmp_path):
    path = tmp_path / "lies.zip"
    path.write_bytes(with_stated_size(archive(zipfile.ZIP_DEFLATED, TEXT), 10**6))
    with pytest.raises(FileError, match=r"member0 has 40000 bytes, not 1000000"):
        read_zip_members(path, ["member0"])


def test_a_missing_member_is_named(tmp_path):
    path = tmp_path / "some.zip"
    path.write_bytes(archive(zipfile.ZIP_STORED, TEXT))
    with pytest.raises(FileError, match=r"some\.zip: has no member other"):
        read_zip_members(path, ["member0", "other"])


@pytest.mark.parametrize("compression", METHODS[1:])
@pytest.mark.parametrize("at", [45, 60, 100, 900])
def test_broken_data_of_every_compression_are_one_error(tmp_path, compression, at):
    content = bytearray(archive(compression, np.random.default_rng(0).bytes(2000)))
    for byte in range(at, at + 6):
        content[byte] ^= 0x55
    (tmp_path / "broken.zip").write_bytes(content)
    with pytest.raises(FileError, match=r"broken\.zip: not a ZIP archive that can be read: ."):
        read_zip_members(tmp_path / "broken.zip", ["member0"])


def test_bzip2_is_refused_because_a_few_bytes_of_it_unpack_to_gigabytes(tmp_path):
    (tmp_path / "some.zip").write_bytes(archive(zipfile.ZIP_BZIP2, TEXT))
    with pytest.raises(FileError, match=r"some\.zip: .*member0 is packed with bzip2"):
        read_zip_members(tmp_path / "some.zip", ["member0"])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [(6, 1, "encrypted"), (8, 99, "compression"), (8, 1, "compression")],
)
def test_encrypted_members_and_unknown_methods_are_named(tmp_path, field, value, message):
    content = bytearray(archive(zipfile.ZIP_DEFLATED, TEXT))
    entry = content.index(b"PK\x01\x02")
    content[field : field + 2] = struct.pack("<H", value)
    content[entry + field + 2 : entry + field + 4] = struct.pack("<H", value)
    (tmp_path / "other.zip").write_bytes(content)
    with pytest.raises(FileError, match=rf"other\.zip: .*{message}"):
        read_zip_members(tmp_path / "other.zip", ["member0"])


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x05\x06" + bytes(17)])
def test_a_file_that_is_no_archive_is_named(tmp_path, content):
    (tmp_path / "no.zip").write_bytes(content)
    with pytest.raises(FileError, match=r"no\.zip: not a ZIP archive that can be read"):
        read_zip_members(tmp_path / "no.zip", ["member0"])
    with pytest.raises(FileError, match=r"nowhere\.zip: there is no such file"):
        read_zip_members(tmp_path / "nowhere.zip", ["member0"])
