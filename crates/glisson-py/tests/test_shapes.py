"""Images, surfaces, meshes and static cases as arrays."""

import subprocess
import sys

import numpy as np
import pytest

import glisson
from conftest import BLOCK, pressed
from glisson import interchange

SPACING = [3e-3, 2.5e-3, 4e-3]


def ball_image(radius_m=0.04, noise=5.0):
    """A ball of soft tissue in fat, its voxels not cubes, and where it is: its middle and the voxels in it."""
    shape = (50, 56, 40)
    origin = np.array([-0.08, -0.07, 0.02])
    places = [np.arange(n) * h + o for n, h, o in zip(shape, SPACING, origin, strict=True)]
    grid = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
    middle = origin + 0.5 * (np.array(shape) - 1) * SPACING
    inside = np.linalg.norm(grid - middle, axis=-1) < radius_m
    values = np.where(inside, 60.0, -100.0) + np.random.default_rng(1).normal(0.0, noise, shape)
    return glisson.Image(values, SPACING, origin), middle, inside


def box(n=(6, 2, 2), size=(0.06, 0.02, 0.02)):
    """Nodes and tetrahedra of a box: cubes of six each, around a diagonal."""
    counts = np.array(n) + 1
    index = np.arange(counts.prod()).reshape(counts)
    nodes = np.stack(np.meshgrid(*[np.linspace(0, s, c) for s, c in zip(size, counts, strict=True)], indexing="ij"), -1).reshape(-1, 3)
    paths = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
    tets = []
    for cell in np.ndindex(*n):
        for path in paths:
            at = np.array(cell)
            corners = [index[tuple(at)]]
            for axis in path:
                at = at + np.eye(3, dtype=int)[axis]
                corners.append(index[tuple(at)])
            tets.append(corners)
    return nodes, np.array(tets)


def test_an_image_becomes_a_mesh(tmp_path):
    image, middle, inside = ball_image()
    assert image.values.shape == inside.shape and image.values.dtype == np.float32
    assert np.allclose(image.axes, np.eye(3)) and np.allclose(image.spacing_m, SPACING)
    shares = []
    labels = glisson.segment(image, [middle], name="ball", progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert labels.names == {1: "ball"}
    found = labels.values == 1
    assert 2 * (found & inside).sum() / (found.sum() + inside.sum()) > 0.97
    assert labels.volume_m3("ball") == pytest.approx(found.sum() * np.prod(SPACING))
    assert labels.volume_m3(1) == labels.volume_m3(np.uint16(1)) == labels.volume_m3("1")
    surface = glisson.surface_of(labels)
    assert surface.volume_m3 == pytest.approx(labels.volume_m3(), rel=1e-3)
    assert np.allclose(surface.positions_m.mean(axis=0), middle, atol=2e-3)
    mesh = glisson.mesh(surface, 1500)
    assert abs(len(mesh.tetrahedra) - 1500) <= 75
    same = glisson.mesh(labels, 1500)
    assert same.volume_m3 == pytest.approx(labels.volume_m3(), rel=1e-3)
    quality = glisson.check(mesh)
    assert quality["problems"] == [] and quality["min_dihedral_deg"] > 10
    assert glisson.check(surface)["surface_euler_characteristic"] == 2 and glisson.check(surface)["faults"] == []
    turned = glisson.Surface(surface.positions_m, surface.triangles[:, ::-1])
    assert turned.volume_m3 < 0 and glisson.mesh(turned, 1500).volume_m3 == pytest.approx(mesh.volume_m3)
    skin = mesh.surface()
    assert skin.volume_m3 == pytest.approx(mesh.volume_m3)

    # To files and back, and into a world.
    image.save(tmp_path / "ct.nii.gz")
    again = glisson.Image.load(tmp_path / "ct.nii.gz")
    assert np.allclose(again.values, image.values) and np.allclose(again.origin_m, image.origin_m)
    labels.save(tmp_path / "labels.seg.nrrd")
    assert (glisson.Labels.load(tmp_path / "labels.seg.nrrd").values == labels.values).all()
    surface.save(tmp_path / "ball.ply")
    assert glisson.Surface.load(tmp_path / "ball.ply").triangles.shape == surface.triangles.shape
    mesh.save(tmp_path / "ball.vtu", {"height_m": mesh.positions_m[:, 2], "number": np.arange(len(mesh.tetrahedra))})
    back = glisson.Mesh.load(tmp_path / "ball.vtu")
    assert (back.tetrahedra == mesh.tetrahedra).all() and np.allclose(back.positions_m, mesh.positions_m, atol=1e-12)
    organ = {"mesh": "ball.vtu", "tissue": "liver", "model": "implicit", "fixed": [{"furthest": {"direction": [0, 1, 0], "fraction": 0.2}}]}
    scene = glisson.scene_from_dict({**BLOCK, "organ": organ}, tmp_path)
    world = glisson.World(scene)
    world.step(2)
    assert len(world.tetrahedra) == len(mesh.tetrahedra)


def test_an_axis_that_runs_the_other_way_does_not_turn_the_organ():
    image, middle, inside = ball_image(noise=0.0)
    values = (image.values > 0).astype(np.uint8)
    last = np.array(image.origin_m) + [0, 0, (values.shape[2] - 1) * SPACING[2]]
    flipped = glisson.Labels(values[:, :, ::-1], SPACING, last, np.diag([1.0, 1.0, -1.0]), names={1: "ball"})
    straight = glisson.Labels(inside, SPACING, image.origin_m, names={1: "ball"})
    for labels in (flipped, straight):
        surface = glisson.surface_of(labels, "ball")
        assert surface.volume_m3 > 0 and np.allclose(surface.positions_m.mean(axis=0), middle, atol=1e-3)


def test_a_bar_is_stretched_as_the_formula_says():
    nodes, tets = box()
    mesh = glisson.Mesh(nodes, tets)
    young, poisson, stretch = 5000.0, 0.3, 1e-3
    prescribed = np.full(nodes.shape, np.nan)
    for axis in range(3):
        prescribed[nodes[:, axis] == 0, axis] = 0.0
    prescribed[nodes[:, 0] == nodes[:, 0].max(), 0] = stretch * 0.06
    expected = nodes * [stretch, -poisson * stretch, -poisson * stretch]
    solution = glisson.solve(mesh, young, poisson, prescribed)
    assert np.allclose(solution.displacement_m, expected, atol=1e-12)
    pull = solution.reaction_n[nodes[:, 0] == nodes[:, 0].max(), 0].sum()
    assert pull == pytest.approx(young * stretch * 0.02**2) and solution.energy_j is None
    ogden = glisson.solve(mesh, young, poisson, prescribed, law="ogden", parameters={"exponent": -4.7})
    assert np.allclose(ogden.displacement_m, expected, atol=2e-6 * stretch / 1e-3)
    assert ogden.energy_j == pytest.approx(0.5 * pull * stretch * 0.06, rel=1e-2) and ogden.residual_n < 1e-6
    fibres = {"k1": "2 kPa", "k2": 5, "fibre": [[1, 0, 0], [1, 1, 0]]}
    stiffer = glisson.solve(mesh, young, poisson, prescribed, law="holzapfel_gasser_ogden", parameters=fibres)
    assert stiffer.reaction_n[nodes[:, 0] == 0, 0].sum() < -pull


def test_weight_and_forces_are_carried():
    nodes, tets = box()
    mesh = glisson.Mesh(nodes, tets)
    prescribed = np.full(nodes.shape, np.nan)
    prescribed[nodes[:, 0] == 0] = 0.0
    weight = glisson.solve(mesh, 5000.0, 0.3, prescribed, density_kg_per_m3=1000.0, gravity_m_per_s2=[0, 0, -9.81])
    assert weight.reaction_n.sum(axis=0) == pytest.approx([0, 0, mesh.volume_m3 * 9810], abs=1e-9)
    forces = np.zeros(nodes.shape)
    forces[-1] = [0, 1e-3, 0]
    assert glisson.solve(mesh, 5000.0, 0.3, prescribed, forces).reaction_n[:, 1].sum() == pytest.approx(-1e-3)


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda: glisson.Image.load("nowhere.nii"), glisson.MeshError, "nowhere.nii"),
        (lambda: glisson.Image(np.zeros((2, 2)), SPACING), TypeError, "ndarray|array|dimension"),
        (lambda: glisson.Image(np.zeros((2, 0, 2)), SPACING), ValueError, "no voxel"),
        (lambda: glisson.Image(np.zeros((2, 2, 2)), [1, 1, 0]), ValueError, "spacing_m"),
        (lambda: glisson.Image(np.zeros((2, 2, 2)), SPACING, axes=np.ones((3, 3))), ValueError, "right angles"),
        (lambda: glisson.Labels(np.zeros((2, 2, 2)), SPACING), TypeError, "uint16"),
        (lambda: glisson.Labels([[[0.5, 1.7]]], SPACING), TypeError, "uint16"),
        (lambda: glisson.Labels(np.full((2, 2, 2), 70_000), SPACING), ValueError, "65535"),
        (lambda: glisson.Surface(np.eye(3), [[0.9, 1.9, 2.9]]), TypeError, "whole numbers"),
        (lambda: glisson.surface_of(glisson.Labels(np.ones((9, 9, 9), int), SPACING)), glisson.MeshError, "border"),
        (lambda: glisson.surface_of(glisson.Labels(np.ones((9, 9, 9), int), SPACING), "spleen"), glisson.MeshError, "spleen"),
        (lambda: glisson.segment(glisson.Image(np.zeros((9, 9, 9)), SPACING), [[1, 0, 0]]), glisson.MeshError, "outside"),
        (lambda: glisson.segment(glisson.Image(np.zeros((9, 9, 9)), SPACING), [0, 0, 0]), ValueError, r"inside_m.*\(points, 3\)"),
        (lambda: glisson.Mesh(np.zeros((3, 3)), [[0, 1, 2, 3]]), ValueError, "node 3; there are 3"),
        (lambda: glisson.Mesh(np.zeros((4, 3)), [[0, 1, 2]]), ValueError, r"\(n, 4\)"),
        (lambda: glisson.Mesh(np.zeros((4, 3)), np.array([[0.0, 1, 2, 3]])), TypeError, "whole numbers"),
        (lambda: glisson.Mesh([[np.nan, 0, 0]], [[0, 0, 0, 0]]), ValueError, "not finite"),
        (lambda: glisson.Mesh(np.zeros((4, 3)), np.zeros((0, 4), int)), glisson.MeshError, "no tetrahedr"),
        (lambda: glisson.Surface.load("a.stl", "furlong"), ValueError, "furlong"),
        (lambda: glisson.mesh(3), TypeError, "int cannot be meshed"),
        (lambda: glisson.mesh(glisson.Surface(*triangle()), 500), glisson.MeshError, "closed"),
        (lambda: glisson.mesh(glisson.Surface(*triangle()), 500, edge_m=0.01), ValueError, "not both"),
        (lambda: glisson.mesh(glisson.Surface(*triangle()), label="liver"), ValueError, "for Labels"),
        (lambda: glisson.check("x"), TypeError, "str cannot be checked"),
        (lambda: glisson.validate("elastisity"), ValueError, "elasticity"),
    ],
)
def test_what_is_wrong_is_told(make, kind, words):
    with pytest.raises(kind, match=words):
        make()


def triangle():
    return np.eye(3), np.array([[0, 1, 2]])


def test_what_is_wrong_with_a_case_is_told():
    nodes, tets = box((1, 1, 1))
    mesh = glisson.Mesh(nodes, tets)
    free = np.full(nodes.shape, np.nan)
    with pytest.raises(glisson.MeshError, match="floats: 6 of its 6"):
        glisson.solve(mesh, 5000.0, 0.3, free)
    held = np.where(nodes == 0, 0.0, np.nan)
    for words, wrong in [
        ("prescribed_m", {"prescribed_m": free[1:]}),
        ("infinite", {"prescribed_m": np.full(nodes.shape, np.inf)}),
        ("forces_n has", {"forces_n": np.zeros((2, 3))}),
        ("neo_hooke", {"law": "neo_hoke_log"}),
        (r'parameters\["alpha"\].*exponent', {"law": "ogden", "parameters": {"alpha": 2}}),
        ("exponent", {"law": "ogden"}),
        ("poisson|Poisson", {"poisson": 0.5}),
        ("first_load_step", {"law": "neo_hooke_log", "first_load_step": 0.0}),
        ("density", {"gravity_m_per_s2": [0.0, 0.0, -9.81]}),
        ("exponent", {"law": "ogden", "parameters": {"exponent": []}}),
    ]:
        with pytest.raises(ValueError, match=words):
            glisson.solve(**{"mesh": mesh, "young_pa": 5000.0, "poisson": 0.3, "prescribed_m": held, **wrong})


def test_a_mesh_that_is_wrong_says_what():
    nodes, tets = box((1, 1, 1))
    doubled = glisson.Mesh(np.vstack([nodes, nodes[:1]]), np.vstack([tets, tets[:1, [0, 2, 1, 3]]]))
    told = glisson.check(doubled)
    assert told["faults"]["loose_nodes"] == [8] and told["faults"]["repeated_tetrahedra"] == [[6, 0]]
    assert any("loose" in line or "no tetrahedron" in line for line in told["problems"])


def test_progress_can_end_the_work():
    image, middle, _ = ball_image()

    def stop(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        glisson.segment(image, [middle], progress=stop)
    nodes, tets = box()
    case = {"mesh": glisson.Mesh(nodes, tets), "young_pa": 5000.0, "poisson": 0.3, "prescribed_m": np.where(nodes == 0, 0.0, np.nan)}
    weight = {"density_kg_per_m3": 1000.0, "gravity_m_per_s2": [0.0, 0.0, -9.81]}
    for law in ("linear", "neo_hooke_log"):
        with pytest.raises(KeyboardInterrupt):
            glisson.solve(**case, **weight, law=law, progress=stop)


def test_a_group_of_claims_is_reproduced():
    assert "elasticity" in glisson.validation_groups()
    rows = glisson.validate("tubes")
    assert rows and all(row["pass"] for row in rows) and {"name", "source", "expected", "obtained", "tolerance"} <= rows[0].keys()


def test_moments_of_a_world_are_a_series(tmp_path, scene):
    world = glisson.World(scene)
    with glisson.Series(tmp_path / "press.pvd") as series:
        for _ in range(3):
            world.step(10)
            series.add(world)
        assert len(series) == 3
    series.close()
    with pytest.raises(glisson.SimulationError, match="closed"):
        series.add(world)
    text = (tmp_path / "press.pvd").read_text()
    assert text.count("organ_") == text.count("tools_") == 3
    moment = glisson.Mesh.load(tmp_path / "press_files" / "organ_00002.vtu")
    assert np.allclose(moment.positions_m, world.positions_m, atol=1e-9)
    with pytest.raises(glisson.SimulationError, match=".pvd"):
        glisson.Series(tmp_path / "press.vtu")


def test_a_moment_does_not_depend_on_those_before(tmp_path, scene):
    world = glisson.World(scene)
    saved = world.save()
    with glisson.Series(tmp_path / "several.pvd") as several:
        for cut in ([0], [200]):
            world.restore(saved)
            world.remove(cut)
            world.step(5, pressed(world))
            several.add(world)
    with glisson.Series(tmp_path / "alone.pvd") as alone:
        alone.add(world)
    assert (tmp_path / "alone_files/organ_00000.vtu").read_bytes() == (tmp_path / "several_files/organ_00001.vtu").read_bytes()


def test_modules_come_when_they_are_asked_for():
    code = "import glisson, sys; assert 'glisson.viewer' not in sys.modules; print(glisson.viewer.launch_passive, glisson.kinematics.Chain)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    with pytest.raises(AttributeError, match="viewr"):
        glisson.viewr


@pytest.mark.parametrize("other", ["meshio", "pyvista"])
def test_other_programs_take_and_give_meshes(scene, other):
    pytest.importorskip(other)
    there, back = getattr(interchange, f"to_{other}"), getattr(interchange, f"from_{other}")
    world = glisson.World(scene)
    mesh = glisson.Mesh(world.rest_positions_m, world.tetrahedra)
    again = back(there(mesh))
    assert (again.tetrahedra == mesh.tetrahedra).all() and (again.positions_m == mesh.positions_m).all()
    assert back(there(mesh.surface())).volume_m3 == pytest.approx(mesh.volume_m3)
    assert np.allclose(back(there(mesh), 1e-3).positions_m, 1e-3 * mesh.positions_m)
    data = there(world, {"number": np.arange(len(world.tetrahedra)), "height_m": world.positions_m[:, 2]})
    at_nodes = data.point_data
    assert at_nodes["displacement_m"].shape == world.positions_m.shape and {"stress_pa", "height_m"} <= set(at_nodes.keys())
    assert "number" in data.cell_data.keys()
    with pytest.raises(ValueError, match="field x"):
        there(mesh, {"x": np.zeros(3)})


def test_what_cannot_be_taken_is_told():
    meshio = pytest.importorskip("meshio")
    with pytest.raises(ValueError, match="neither a tetrahedron.*line"):
        interchange.from_meshio(meshio.Mesh(np.zeros((2, 3)), [("line", [[0, 1]])]))
