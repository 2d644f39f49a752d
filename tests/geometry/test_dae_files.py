"""Units, axes, nodes and primitives of COLLADA files."""

import numpy as np
import pytest

pytest.importorskip("trimesh")

from plain.meshes import DAE_NODES, SIZE, VERTICES, dae, refusal


@pytest.mark.parametrize(
    ("asset", "size"),
    [
        ('<unit meter="0.001" name="millimeter"/><up_axis>Z_UP</up_axis>', SIZE / 1000),
        ('<unit name="inch" meter="0.0254"/><up_axis>Z_UP</up_axis>', SIZE * 0.0254),
        ('<unit meter="1e-2"/><up_axis> Z_UP </up_axis>', SIZE / 100),
        ("<unit/><up_axis>Z_UP</up_axis>", SIZE),
        ("<up_axis>Z_UP</up_axis>", SIZE),
    ],
)
def test_a_dae_is_scaled_by_its_unit(read, asset, size):
    for in_urdf in (False, True):
        np.testing.assert_allclose(read("a.dae", dae(asset), in_urdf=in_urdf).extents, size)


@pytest.mark.parametrize(
    ("asset", "tip"),
    [
        ("<up_axis>Z_UP</up_axis>", [0, 0, 4]),
        ("<up_axis>Y_UP</up_axis>", [0, -4, 0]),
        ("", [0, -4, 0]),  # the specification's default
        ("<up_axis>X_UP</up_axis>", [0, -4, 0]),
    ],
)
def test_a_dae_stands_as_its_up_axis_says_but_in_urdfs_as_its_numbers_do(read, asset, tip):
    mesh = read("a.dae", dae(asset))
    np.testing.assert_allclose(mesh.vertices[3], tip, atol=1e-12)
    assert mesh.volume == pytest.approx(4.0)
    np.testing.assert_allclose(read("a.dae", dae(asset), in_urdf=True).vertices, VERTICES)


def test_x_up_puts_x_up(read):
    np.testing.assert_allclose(
        read("a.dae", dae("<up_axis>X_UP</up_axis>")).vertices[:3],
        [[0, 0, 0], [0, 0, 2], [-3, 0, 0]],
        atol=1e-12,
    )


def test_nodes_of_a_dae_place_their_geometries_in_its_unit(read):
    nodes = (
        "<node><translate>10 0 0</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>"
        f'<node id="n">{DAE_NODES}</node></node><node><instance_node url="#n"/></node>'
    )
    mesh = read("a.dae", dae('<unit meter="0.1"/><up_axis>Z_UP</up_axis>', nodes))
    parts = sorted(mesh.split(), key=lambda part: part.bounds[0, 0])
    np.testing.assert_allclose(parts[0].bounds, [[0, 0, 0], [0.2, 0.3, 0.4]], atol=1e-12)
    np.testing.assert_allclose(parts[1].bounds, [[0.7, 0, 0], [1, 0.4, 0.4]], atol=1e-12)


def test_geometries_of_a_dae_may_have_the_same_ids_inside(read):
    start, end = dae().index(b"<geometry"), dae().index(b"</library_geometries>")
    geometry = dae()[start:end]
    other = geometry.replace(b'id="g"', b'id="h"').replace(b"0 0 4<", b"0 0 9<")
    nodes = DAE_NODES + DAE_NODES.replace("#g", "#h")
    content = dae(nodes=nodes)[:end] + other + dae(nodes=nodes)[end:]
    assert read("a.dae", content).volume == pytest.approx(4.0 + 9.0)
    assert "2 elements geometry" in refusal(read, "a.dae", dae()[:end] + geometry + dae()[end:])


def test_a_dae_needs_no_namespace(read):
    plain = dae().replace(b' xmlns="http://www.collada.org/2005/11/COLLADASchema"', b"")
    np.testing.assert_allclose(read("a.dae", plain).vertices, VERTICES)


@pytest.mark.parametrize(
    ("primitive", "area"),
    [
        ('<polylist count="1">{input}<vcount>4</vcount><p>0 1 2 3</p></polylist>', 1.0),
        ('<polylist count="2">{input}<vcount>3 4</vcount><p>0 1 2 0 1 2 3</p></polylist>', 1.5),
        ("<polygons>{input}<p>0 1 2 3</p></polygons>", 1.0),
        ("<tristrips>{input}<p>0 1 3 2</p></tristrips>", 1.0),
        ("<trifans>{input}<p>0 1 2 3</p></trifans>", 1.0),
        ("<lines>{input}<p>0 1 2 3</p></lines><triangles>{input}<p>0 1 2</p></triangles>", 0.5),
    ],
)
def test_polygons_strips_and_fans_of_a_dae_become_triangles(read, primitive, area):
    start, end = dae().index(b"<triangles"), dae().index(b"</mesh>")
    source = '<input semantic="VERTEX" source="#v" offset="0"/>'
    content = dae()[:start] + primitive.format(input=source).encode() + dae()[end:]
    content = content.replace(b"0 0 0 2 0 0 0 3 0 0 0 4", b"0 0 0 1 0 0 1 1 0 0 1 0")
    assert read("a.dae", content).area == pytest.approx(area)
