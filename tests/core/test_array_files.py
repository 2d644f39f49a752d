import numpy as np
import pytest

from coopmap_env.core.array_files import MAX_TEXT_BYTES, read_arrays, read_texts, write_arrays
from coopmap_env.core.files import FileError


class OwnError(FileError):
    pass


def test_arrays_and_texts_are_read_as_they_were_written(tmp_path):
    path = tmp_path / "new" / "arrays.npz"
    rows = np.asfortranarray(np.arange(6).reshape(2, 3))
    write_arrays(path, {"rows": rows, "title": np.array("cells"), "none": np.zeros((0, 2))})
    found = read_arrays(path, ("none", "rows"))
    assert list(found) == ["none", "rows"]
    np.testing.assert_array_equal(found["rows"], rows)
    assert found["none"].shape == (0, 2)
    assert read_texts(path, ("title",)) == ["cells"]


def test_errors_name_the_file_and_the_array(tmp_path):
    path = tmp_path / "arrays.npz"
    long = np.array("x" * (MAX_TEXT_BYTES // 4 + 1))
    write_arrays(path, {"rows": np.arange(3), "long": long})
    with pytest.raises(OwnError, match=r"arrays\.npz: has no member title\.npy"):
        read_arrays(path, ("title",), OwnError)
    for name in ("rows", "long"):
        with pytest.raises(OwnError, match=rf"arrays\.npz: {name}\.npy is broken: expected a text"):
            read_texts(path, (name,), OwnError)
    np.savez(path, rows=np.array([print], dtype=object))
    with pytest.raises(OwnError, match=r"rows\.npy is broken"):
        read_arrays(path, ("rows",), OwnError)
