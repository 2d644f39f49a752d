"""A small mesh as a file of each format that `read_mesh` reads, made by trimesh or by hand."""

import base64
import io
import zipfile

import numpy as np
import pytest
import trimesh

from coopmap_env.core.files import FileError

VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], dtype=float)
"""A tetrahedron of 2 x 3 x 4."""
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
SIZE = np.array([2.0, 3.0, 4.0])

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{asset}</asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 2 0 0 0 3 0 0 0 4</float_array>
<technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>
"""
DAE_NODES = '<node><instance_geometry url="#g"/></node>'

MODEL = """<?xml version="1.0"?>
<model {unit} xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>
<object id="1"><mesh><vertices>
<vertex x="0" y="0" z="0"/><vertex x="2" y="0" z="0"/><vertex x="0" y="3" z="0"/>
<vertex x="0" y="0" z="4"/></vertices><triangles>
<triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/><triangle v1="0" v2="3" v3="2"/>
<triangle v1="1" v2="2" v3="3"/></triangles></mesh></object>{objects}</resources>
<build>{items}</build></model>
"""


PLY = """ply
format ascii 1.0
comment made by hand
element vertex 5
property double x
property double y
property double z
property uchar red
element face 2
property list uchar int vertex_indices
property uchar flags
end_header
0 0 0 9
1 0 0 9
1 1 0 9
0 1 0 9
0 0 1 9
4 0 1 2 3 7
3 0 1 4 7
"""
"""By hand: a square and a triangle, with properties that are not read."""


def tetrahedron():
    return trimesh.Trimesh(VERTICES, FACES, process=False)


def exported(suffix, **options):
    """Content of the tetrahedron as trimesh writes it."""
    content = tetrahedron().export(file_type=suffix, **options)
    return content.encode() if isinstance(content, str) else content


def dae(asset='<unit meter="1"/><up_axis>Z_UP</up_axis>', nodes=DAE_NODES):
    return DAE.format(asset=asset, nodes=nodes).encode()


def gltf():
    """A glTF whose buffer is part of its text."""
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(tetrahedron()))
    text = files["model.gltf"]
    for name, content in files.items():
        data = "data:application/octet-stream;base64," + base64.b64encode(content).decode()
        text = text.replace(f'"{name}"'.encode(), f'"{data}"'.encode())
    return text


def archive(compression=zipfile.ZIP_DEFLATED, **members):
    """A zip archive."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return buffer.getvalue()


def threemf(unit='unit="meter"', objects="", items='<item objectid="1"/>'):
    model = MODEL.format(unit=unit, objects=objects, items=items)
    return archive(**{"3D/3dmodel.model": model})


def every_format():
    """Content of the tetrahedron, 2 x 3 x 4 m with z up, in each format; by ending."""
    return {
        ".stl": [exported("stl"), exported("stl_ascii")],
        ".obj": [exported("obj")],
        ".ply": [exported("ply"), exported("ply", encoding="ascii")],
        ".off": [exported("off")],
        ".dae": [dae()],
        ".zae": [archive(**{"a.dae": dae()})],
        ".3mf": [threemf()],
        ".gltf": [gltf()],
        ".glb": [exported("glb")],
    }


def refusal(read, name, content):
    """Message of the error of a broken file, which must begin with its path."""
    with pytest.raises(FileError) as caught:
        read(name, content)
    message = str(caught.value)
    assert f"/{name}" in message.split(": ")[0]
    assert len(message) < 1000
    return message
