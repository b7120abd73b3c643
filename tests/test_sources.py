"""What the five texts state that are implemented, and which test shows it: one row for each statement, in their order.

A row is `place | statement | shown by`. The last is a test (in tests/), "survey" (the text reviews others' work),
"figure" (with the picture here that shows it, if there is one), "left out: why", or "differs: how" (on purpose).
"""

import ast
import re

from pages import ROOT

TEXTS = {
    "Tu 1996, semi-implicit Euler": """
intro | A left turn before a right one ends may become unstable | test_benchmarks.py::test_turn
intro | Semi-implicit Euler is stable | differs: up to symplectic Euler's limit, test_stability.py::test_linear_limits
motion | M x'' + C x' + K x = f | test_forces.py::test_rest_matrices
motion | M is constant, with the nodes' masses on its diagonal | test_methods.py::test_step_equals_its_reference
motion | C and K are not diagonal and change with time | test_methods.py::test_steps_equal_their_reference
motion | Viscous and elastic terms make one implicit stiffness | test_methods.py::test_step_equals_its_reference
method | Solved for velocities: no older positions are kept | test_methods.py::test_calls_add_up
method | The new velocity moves positions: first order | test_methods.py::test_order
method | The system's structure allows an efficient solution | test_bodies.py::test_band_and_skyline
method | L D L^T, then forward and back substitution | test_linear_algebra.py::test_factors_and_solution
method | One assembly, factorisation and solution a step | test_stability.py::test_counters
""",
    "Song 2009, two-layer objects": """
abstract | Two surfaces of springs around gas | soft/test_objects.py::test_built_at_rest
abstract | Layers may differ in density | soft/test_objects.py::test_densities
abstract | Layers may move oppositely | soft/test_objects.py::test_layers_move_against_each_other_after_an_impact
abstract | Gravity; walls, ceiling and floor | soft/test_objects.py::test_nothing_leaves_a_closed_room
abstract | Simulated in real time | test_tables.py::test_pages
abstract | Users deform objects and watch the response | test_lab.py::test_a_drag_brings_the_node_to_the_pointer
1.1.1 | Elastic deformation is reversible | soft/test_solids.py::test_comes_back_to_its_shape
1.1.1 | Plastic deformation is not | left out: the text defines it, and its objects are elastic
1.1.1 | Too far stretched, a material tears | soft/test_elements.py::test_torn_by_the_largest_stretch
1.1.2 | Volume stays constant in a collision | differs: isothermal gas loses volume where it is pressed
1.2 | Animation techniques, rates of pictures, and uses of elastic models | survey
1.3 | Kinematics: motion is given beforehand | soft/test_conditions.py::test_prescribed_motions_end
1.3 | Dynamics: forces cause the motion | test_lab.py::test_free_fall_is_that_of_gravity
1.6 | Parameters are changed while it moves | soft/test_objects.py::test_changed_while_it_moves
2.1 | Particles without springs, deformable surfaces, fluid models | survey
2.1 | Springs need shorter steps than elements | differs: soft/test_solids.py::test_elements_take_shorter_steps
2.1 | Elements come to rest at least potential energy | soft/test_solids.py::test_clamped_beam_sags_to_its_equilibrium
2.1 | Elements agree with continuum mechanics | soft/test_solids.py::test_cantilever_converges
2.1 | A surface filled with gas acts as a balloon | soft/test_objects.py::test_one_layer_swells_as_in_closed_form
2.2 | Accuracy costs computing time | figure: benchmarks/results/work_precision.svg
3.2 | Particles have mass and position | test_bodies.py::test_make_body
3.2 | Springs have a length and join two particles | test_bodies.py::test_make_body_refuses
3.2 | Faces have springs as edges | soft/test_objects.py::test_sphere_of_latitudes
3.3 | One end is fixed, the other moves along a line | soft/test_objects.py::test_string_resists_either_way
3.3 | The user pulls at the end | soft/test_objects.py::test_scene
3.3 | Compressed or stretched, its spring restores it | soft/test_objects.py::test_string_resists_either_way
3.4 | Two circles joined to one object | soft/test_objects.py::test_only_rigid_motions_are_free
3.4.1 | Particles at equal angles on two circles | soft/test_objects.py::test_springs_of_the_ring
3.4.1 | Structural springs join neighbours of a circle | soft/test_objects.py::test_springs_of_the_ring
3.4.1 | Radius springs join partners, shear springs cross both ways | soft/test_objects.py::test_springs_of_the_ring
3.4.1 | Springs between layers resist bending and folding | soft/test_objects.py::test_only_rigid_motions_are_free
3.4.1 | Faces serve to draw | test_render.py::test_draws_objects
3.4.1 | Pictures of each kind of spring | figure: benchmarks/results/objects_texts.svg
3.4.2 | The number of particles is chosen | test_lab.py::test_another_object_is_another_look
3.5.1 | Particles in spherical coordinates, two radii | soft/test_objects.py::test_sphere_of_latitudes
3.5.1 | Quadrilaterals, and triangles at the poles | soft/test_objects.py::test_sphere_of_latitudes
3.5.2 | Octahedron: 6 particles, 12 springs, 8 faces | soft/test_objects.py::test_uniform_sphere_counts
3.5.2 | Its particles are equally far apart | soft/test_objects.py::test_uniform_sphere_counts
3.5.2 | Faces become four; middles of edges move onto the sphere | soft/test_objects.py::test_uniform_sphere_counts
3.5.2 | Divided once: 12 particles, 36 springs, 32 faces | differs: 18, 48, 32, by Euler's formula
3.5.2 | Divided again, it comes nearer to a sphere | soft/test_objects.py::test_volume_is_of_second_order
3.5.2 | Pictures of the sphere | figure: docs/images/gallery/uniform_sphere.webp
3.5.3 | Detail follows the distance | soft/test_objects.py::test_level_of_detail
3.5.3 | Latitudes: faces and springs shorter at poles | soft/test_objects.py::test_sphere_of_latitudes
3.5.3 | Latitudes: larger errors of forces | differs: pressure and normals are exact on any mesh
3.5.3 | Kernel points have four springs, others six | soft/test_objects.py::test_uniform_sphere_counts
3.5.3 | Icosahedra and tetrahedra as kernels | left out: the text uses the octahedron
3.5.3 | Pressure moves kernel points further | soft/test_objects.py::test_correction_rounds_the_ball
3.5.3 | A factor 6/n evens forces | differs: a spring is as stiff as its tension over its length needs
3.5.3 | Pressure and stiffness by trial | differs: springs balance the gas, soft/test_objects.py::test_built_at_rest
4.1 | Weight is mass times g | soft/test_elements.py::test_walls_and_air
4.2, 4.3 | Springs and dampers act along themselves | test_forces.py::test_force
4.2 | Left and right shear springs differ in stiffness | left out: both have one, as a ring is symmetric
4.3 | Each kind has its damping | soft/test_objects.py::test_damping_of_each_kind
4.3 | Damping takes energy | test_forces.py::test_damping_only_takes_energy_away
4.3 | Damping is needed for stability | test_tank.py::test_no_stable_step
4.4 | The mouse takes the nearest particle, until it is released | soft/test_objects.py::test_mouse
4.4 | A spring with damper pulls it to the mouse | soft/test_conditions.py::test_dragged_mass
4.4 | The mouse has a velocity | soft/test_objects.py::test_a_hand_that_jumps_does_not_converge
4.4 | Either end of a string may be free | soft/test_objects.py::test_string_with_masses_of_its_own
4.4 | The outer layer alone is dragged | test_lab.py::test_a_drag_brings_the_node_to_the_pointer
4.5 | Pressure acts along outward normals | soft/test_elements.py::test_gas_pushes_all_round
4.5 | Without springs gas bursts | soft/test_objects.py::test_gas_of_a_layer_may_be_missing
4.5 | Without gas it collapses, unless springs are hard | differs: two layers hold if laid down, not if dropped
4.5 | Gas restores the shape | soft/test_objects.py::test_collapse_and_what_pressure_restores
4.5 | Pictures of a ring without and with gas | figure: benchmarks/results/objects_texts.svg
4.5 | P V = n R T | soft/test_elements.py::test_gas_pushes_all_round
4.5.1 | Volume by Gauss' theorem | soft/test_elements.py::test_volume
4.5.1 | Area by Green's theorem | soft/test_elements.py::test_volume_equals_its_reference
4.5.1 | Volume estimated from springs along x | differs: exact, soft/test_elements.py::test_volume
4.5.2 | Normals of particles, as means of faces | left out: the text does not use them
4.5.2 | Normals of lines and faces | soft/test_elements.py::test_volume_equals_its_reference
4.5.2 | In 3-D a line is turned about three axes | differs: at times wrong, as the text shows; here exact
4.6.1 | Each particle is checked against each plane | soft/test_elements.py::test_walls_and_air
4.6.1, 4.6.2 | Reflection with a restitution from 0 to 1 | soft/test_objects.py::test_bounce
4.6.2 | Walls and floor bound outer layers | soft/test_objects.py::test_scene
4.6.2 | The outer layer bounds the inner one | soft/test_objects.py::test_every_mesh_holds
4.7 | Particles of a string may differ in mass | soft/test_objects.py::test_string_with_masses_of_its_own
4.7 | Forces of all kinds are added | test_forces.py::test_total
4.7 | Liquid or rubber inside | left out: the text has gas only
4.7 | Forces, then motion, then collisions | soft/test_soft_methods.py::test_steps_at_walls_equal_their_reference
5.1.1 | Explicit Euler: the slope at the start | soft/test_soft_methods.py::test_step_equals_its_reference
5.1.2 | Midpoint: the slope in the middle | soft/test_soft_methods.py::test_step_equals_its_reference
5.1.2 | Pseudocode: mean of two slopes | differs: the text's equations have the slope in the middle
5.1 | Euler is the least stable, midpoint stabler | soft/test_objects.py::test_stable_steps_grow_from_euler_to_rk4
5.1.3 | RK4: slopes weighted 1, 2, 2, 1 | soft/test_soft_methods.py::test_step_equals_its_reference
5.1 | Orders of accuracy: 1, 2 and 4 | test_methods.py::test_order
5.1 | Pictures of the slopes that the methods take | figure
5.3.1 | Evaluations 1 : 2 : 4 | test_stability.py::test_counters
5.3.1 | Computing time 1 : 2 : 4 | figure: benchmarks/results/objects_texts.svg
5.3 | Accuracy of the three | figure: benchmarks/results/objects_methods.svg
""",
    "Corotational finite elements": """
10.3.4 | With linear strain the matrix is constant | soft/test_soft_methods.py::test_what_is_not_constant
10.3.4 | Unless the body changes | soft/test_soft_methods.py::test_factored_again_when_it_changes
10.3.4 | Linear strain sees rotations | soft/test_elements.py::test_rigid_motion_costs_nothing
10.3.4 | Right for small motion | soft/test_solids.py::test_linear_and_corotational_agree_on_small_motion
10.3.4 | Large bending swells it | soft/test_solids.py::test_large_bending
10.3.4 | Green-Lagrange strain allows rotations | soft/test_solids.py::test_patch
10.3.4 | It costs more | differs: than linear strain, but less than corotational, benchmarks/results/solids_methods.csv
10.3.4 | Corotational strain is a good compromise | soft/test_solids.py::test_large_bending
10.3.4 | Forces are found in rotated frames | soft/test_elements.py::test_rotation_of_any_matrix
""",
    "Boundary conditions": """
10.3.5 | Statics need fixed nodes | soft/test_solids.py::test_refused_problems
10.3.5 | Nodes are constrained in motion too | soft/test_conditions.py::test_fixed_stays_to_the_bit
10.3.5 | Fixed: their rows and columns are removed | soft/test_conditions.py::test_motion_equals_the_reduced_system
10.3.5 | Unknown displacements by known forces | soft/test_conditions.py::test_static_problem
10.3.5 | Nodes are moved to desired places | soft/test_conditions.py::test_driven_bar
10.3.5 | Displacements give forces | soft/test_conditions.py::test_bar_by_hand
10.3.5 | Elimination is exact | soft/test_conditions.py::test_static_problem
10.3.5 | Penalty: 10,000 largest entries on the diagonal | soft/test_conditions.py::test_static_problem
10.3.5 | The penalty is a good approximation | soft/test_conditions.py::test_static_problem
""",
    "Dynamic system": """
10.3.3 | M u'' + D u' + K u = f | soft/test_solids.py::test_decay_of_the_first_mode
10.3.3 | Inverses of sparse matrices are dense | figure: benchmarks/results/objects_texts.svg
10.3.3 | Damping may be diagonal | soft/test_elements.py::test_walls_and_air
10.3.3 | Lumped: the mass shared equally | soft/test_objects.py::test_solids_with_equal_masses
10.3.3 | Lumped: a quarter of each tetrahedron | soft/test_solids.py::test_box_and_lumped_mass
10.3.3 | Matrices are computed once | soft/test_soft_methods.py::test_same_bits_as_with_refactorisation
10.3.3 | Equations of first order | test_methods.py::test_step_equals_its_reference
10.3.3 | Implicit Euler is more robust | test_stability.py::test_large_steps
10.3.3 | Others may be faster | figure: benchmarks/results/solids_methods.svg
10.3.3 | Positions take the velocity at the end | soft/test_solids.py::test_implicit_method_is_implicit_euler
10.3.3 | S = M + h D + h^2 K | soft/test_soft_methods.py::test_step_equals_its_reference
""",
}
NODE = r"([\w/]+\.py)::(test_\w+)"
ROWS = [row.split(" | ") for table in TEXTS.values() for row in table.strip().split("\n")]


def names_in(path):
    """Names of the tests in a file of tests."""
    return {
        each.name for each in ast.parse((ROOT / "tests" / path).read_text()).body if isinstance(each, ast.FunctionDef)
    }


def test_rows_end_in_what_shows_them():
    """Every row has three parts, and ends in a test, or one of the words, with a reason where one is needed."""
    for row in ROWS:
        assert len(row) == 3 and 0 < len(row[1].split()) <= 12, row
        assert re.fullmatch(NODE + r"|survey|figure(: \S+\.(svg|webp))?|(left out|differs): .{7,}", row[2]), row


def test_what_is_named_exists():
    """Every test that a row names is in its file, and every picture and table in its place."""
    for *_, shown in ROWS:
        for path, name in re.findall(NODE, shown):
            assert name in names_in(path), shown
        for path in re.findall(r"(?:docs|benchmarks)/\S+", shown):
            assert (ROOT / path).exists(), shown


def test_most_statements_are_shown():
    """Rows of each text, and how many of all are shown by a test or in a picture."""
    assert [len(table.strip().split("\n")) for table in TEXTS.values()] == [11, 91, 9, 9, 11]
    assert sum(bool(re.match(NODE + "|figure: ", shown)) for *_, shown in ROWS) >= 95
