"""The exported numbers make the rays of docs/look-up/conventions.md: by the toolkit or its formulas."""

import math
import warnings

import numpy as np
import pytest

from sawmill_tomography.geometry.export import cil_arguments, odl_arguments, rtk_arguments
from sawmill_tomography.geometry.geometry import FanBeamGeometry, cell_centres_mm
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection.analytic import DetectorCells, project

FIELD_MM = 400.0


@pytest.fixture(params=range(6))
def fan(request, scanner, random_thetas, irregular_turn):
    return FanBeamGeometry(scanner, random_thetas(6, seed=5)[request.param], irregular_turn(40, seed=request.param))


def cells(fan):
    """P_km, (views, cells, 2) mm."""
    _, centre, axis = fan.vectors()
    return centre[:, None, :] + cell_centres_mm(fan.scanner)[:, None] * axis[:, None, :]


def shadows(fan, points):
    """Where the rays through the points meet the detector: u in mm, (views, points)."""
    source, centre, axis = fan.vectors()
    found = np.empty((len(source), len(points)))
    for view, point in np.ndindex(found.shape):
        ray = points[point] - source[view]
        found[view, point] = np.linalg.solve(np.stack([ray, -axis[view]], -1), centre[view] - source[view])[1]
    return found


def odl_geometry(arguments):
    odl = pytest.importorskip("odl")
    tomo = pytest.importorskip("odl.applications.tomo")

    def constant(shift):
        return lambda angle: np.broadcast_to(shift, (*np.shape(angle), 2))

    return tomo.FanBeamGeometry(
        odl.nonuniform_partition(arguments["angles_rad"]),
        odl.uniform_partition(
            arguments["detector_min_mm"], arguments["detector_max_mm"], arguments["num_detector_pixels"]
        ),
        src_radius=arguments["src_radius"],
        det_radius=arguments["det_radius"],
        src_to_det_init=arguments["src_to_det_init"],
        det_axis_init=arguments["det_axis_init"],
        src_shift_func=constant(arguments["src_shift_mm"]),
        det_shift_func=constant(arguments["det_shift_mm"]),
    )


def test_odl_has_our_sources_and_cells(fan):
    arguments = odl_arguments(fan)
    geometry, order = odl_geometry(arguments), arguments["view_order"]
    source, _, _ = fan.vectors()
    np.testing.assert_allclose(geometry.src_position(geometry.angles), source[order], atol=1e-9)
    u = geometry.det_partition.grid.coord_vectors[0]
    for view in (0, 17, 39):
        where = geometry.det_point_position(np.full_like(u, geometry.angles[view]), u)
        np.testing.assert_allclose(where, cells(fan)[order[view]], atol=1e-9)


def test_odl_s_projection_of_the_phantom_is_ours(scanner, theta, irregular_turn):
    odl = pytest.importorskip("odl")
    tomo = pytest.importorskip("odl.applications.tomo")
    fan = FanBeamGeometry(scanner, theta, irregular_turn(24, seed=2))
    arguments = odl_arguments(fan)
    size = 400
    space = odl.uniform_discr([-FIELD_MM / 2] * 2, [FIELD_MM / 2] * 2, (size, size), dtype="float32")
    with warnings.catch_warnings():
        # ODL recommends a graphics card.
        warnings.filterwarnings("ignore", message="The 'astra_cpu' backend may be too slow")
        transform = tomo.RayTransform(space, odl_geometry(arguments), impl="astra_cpu")
        theirs = np.asarray(transform(space.element(L_SHAPE.rasterise(size, FIELD_MM))).data)
    ours = project(L_SHAPE, DetectorCells.of(scanner), fan.frame, fan.angles_rad)[arguments["view_order"]]
    assert np.sqrt(np.mean((theirs - ours) ** 2)) < 0.01 * np.sqrt(np.mean(ours**2))


def rotation(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def test_cil_s_turned_system_has_our_sources_and_cells(fan):
    arguments = cil_arguments(fan)
    system = {name: np.array(value) for name, value in arguments["create_Cone2D"].items() if name != "units"}
    panel = arguments["set_panel"]
    u = (np.arange(panel["num_pixels"]) - 0.5 * (panel["num_pixels"] - 1)) * panel["pixel_size"]
    at_zero = system["detector_position"] + u[:, None] * system["detector_direction_x"]
    source, _, _ = fan.vectors()
    for view, angle in enumerate(np.deg2rad(arguments["set_angles"]["angles"])):
        # The object turns counter-clockwise by the angle, so in its image the scanner goes the other way.
        np.testing.assert_allclose(rotation(-angle) @ system["source_position"], source[view], atol=1e-9)
        np.testing.assert_allclose(at_zero @ rotation(-angle).T, cells(fan)[view], atol=1e-9)


def test_cil_leaves_the_system_as_it_is(fan):
    """It turns a system whose middle ray is not along +y, and the image with it."""
    system = cil_arguments(fan)["create_Cone2D"]
    x, y = np.subtract(system["detector_position"], system["source_position"])
    assert x == pytest.approx(0.0, abs=1e-9)
    assert y > 0.0
    assert np.hypot(*system["detector_direction_x"]) == pytest.approx(1.0)
    assert system["rotation_axis_position"] == [0.0, 0.0]


def test_rtk_s_matrices_project_points_to_where_our_rays_end(fan):
    points = np.random.default_rng(6).uniform(-100.0, 100.0, (5, 2))  # mm, inside the largest log
    log = np.random.default_rng(7).uniform(-50.0, 50.0, len(points))
    exported = rtk_arguments(fan)
    theirs = np.stack([points[:, 0], log, -points[:, 1], np.ones(len(points))])
    u, v, w = np.moveaxis(exported["Matrix"] @ theirs, 1, 0)
    np.testing.assert_allclose(u / w, shadows(fan, points), atol=1e-9)
    source, _, _ = fan.vectors()
    # Along the log a point is magnified as its distance from the source along the detector's normal says.
    normal = np.deg2rad(exported["GantryAngle"])
    towards = np.stack([np.sin(normal), -np.cos(normal)], -1)
    depth = np.einsum("vpc,vc->vp", source[:, None, :] - points, towards)
    np.testing.assert_allclose(v / w, exported["SourceToDetectorDistance"] * log / depth, atol=1e-9)


def test_rtk_s_parameters_place_our_sources_and_cells(fan):
    exported = rtk_arguments(fan)
    source, _, _ = fan.vectors()
    u = cell_centres_mm(fan.scanner) + exported["ProjectionOffsetX"]
    level = exported["SourceToIsocenterDistance"] - exported["SourceToDetectorDistance"]
    for view, gantry in enumerate(np.deg2rad(exported["GantryAngle"])):
        # RTK's documentation of its geometry: x along the detector, z towards the source, turned by the gantry angle.
        x, z = np.array([math.cos(gantry), -math.sin(gantry)]), np.array([math.sin(gantry), math.cos(gantry)])
        at = exported["SourceOffsetX"] * x + exported["SourceToIsocenterDistance"] * z
        np.testing.assert_allclose(at * [1.0, -1.0], source[view], atol=1e-9)
        np.testing.assert_allclose((u[:, None] * x + level * z) * [1.0, -1.0], cells(fan)[view], atol=1e-9)
    assert np.all((exported["GantryAngle"] >= 0.0) & (exported["GantryAngle"] < 360.0))
