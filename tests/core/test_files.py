import pytest

from coopmap_env.core.files import atomic_path, write_atomically


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
