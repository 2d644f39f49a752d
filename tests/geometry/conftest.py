import pytest

from coopmap_env.geometry.mesh_files import read_mesh


@pytest.fixture
def read(tmp_path):
    """Write a file and read it as a mesh."""

    def write_and_read(name, content, **options):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_mesh(path, **options)

    return write_and_read
